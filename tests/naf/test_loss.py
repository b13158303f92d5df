"""NAFLoss held to what TorchRL holds its own losses to."""

import contextlib
import doctest
from copy import deepcopy

import pytest
import torch
from naf.helpers import SUPPORTED, make_data, make_loss, make_network, unchanged
from naf.paper_networks import make_network as make_paper_network
from tensordict import TensorDictParams
from torch import nn
from torchrl.data import MultiStep
from torchrl.objectives import SoftUpdate, ValueEstimators
from torchrl.objectives.value import TD0Estimator

import marl_lanes.naf.loss
from marl_lanes.naf import NAFLoss, torch_internals

KEYS = {
    "advantage": "advantage",
    "value_target": "value_target",
    "value": "state_value",
    "state_action_value": "state_action_value",
    "priority": "td_error",
    "reward": "reward",
    "done": "done",
    "terminated": "terminated",
    "priority_weight": "priority_weight",
}


def updater_warning(expected=True):
    if expected:
        return pytest.warns(UserWarning, match="No target network updater has been")
    return contextlib.nullcontext()


@pytest.mark.parametrize("delay_value", [False, True])
@pytest.mark.parametrize("estimator", [*ValueEstimators, None])
def test_loss(delay_value, estimator):
    network = make_network()
    data = make_data()
    loss = NAFLoss(network, delay_value=delay_value)
    if estimator is not None and estimator not in SUPPORTED:
        with pytest.raises(NotImplementedError, match="NAFLoss"):
            loss.make_value_estimator(estimator)
        return
    if estimator is not None:
        assert loss.make_value_estimator(estimator) is loss
    assert loss.value_type is (estimator or ValueEstimators.TD0)
    with unchanged(data), updater_warning(delay_value):
        output = loss(data)
    if delay_value:
        SoftUpdate(loss, eps=0.5)
    assert data["td_error"].shape == data.shape
    assert not data["td_error"].requires_grad
    torch.testing.assert_close(output["loss"], data["td_error"].mean())

    output["loss"].backward()
    for name, parameter in network.named_parameters():
        assert parameter.grad.norm() > 0, name
    assert set(map(id, loss.parameters())) == set(map(id, network.parameters()))

    target = loss.target_value_network_params.clone()
    before = [p.clone() for p in network.parameters()]
    with torch.no_grad():
        for parameter in loss.parameters():
            parameter += torch.randn_like(parameter)
    assert all((p != q).all() for p, q in zip(before, network.parameters(), strict=True))
    for name in dict(network.named_parameters()):
        key = tuple(name.split("."))
        same = torch.equal(target[key], loss.target_value_network_params[key])
        assert same is delay_value, name


@pytest.mark.parametrize("delay_value", [False, True])
def test_state_dict(delay_value):
    loss = make_loss(delay_value=delay_value)
    loss.make_value_estimator(gamma=0.9)
    other = make_loss(delay_value=delay_value)
    other.make_value_estimator()
    other.load_state_dict(loss.state_dict())
    data = make_data()
    torch.testing.assert_close(other(data)["loss"], loss(data)["loss"], rtol=0, atol=0)


@pytest.mark.parametrize("n", [1, 2, 3])
@pytest.mark.parametrize("delay_value", [False, True])
def test_batcher(n, delay_value):
    loss = make_loss(delay_value=delay_value)
    loss.make_value_estimator(gamma=0.9)
    data = make_data(4, 5)
    data["collector", "mask"] = torch.ones(4, 5, dtype=torch.bool)
    several = MultiStep(gamma=0.9, n_steps=n)(data.clone())
    value = loss(several)["loss"]
    one = loss(data)["loss"]
    if n == 1:
        torch.testing.assert_close(value, one)
    else:
        assert not torch.isclose(value, one)
    value.backward()
    assert all(p.grad.norm() > 0 for p in loss.parameters())


@pytest.mark.parametrize("estimator", SUPPORTED)
def test_tensordict_keys(estimator):
    loss = make_loss(make_network(value_key=("renamed", "value")))
    with pytest.raises(ValueError, match="not an accepted tensordict key"):
        loss.set_keys(unknown="x")
    assert vars(loss.tensor_keys) == KEYS
    renamed = {name: ("renamed", name) for name in KEYS}
    for before in (True, False):
        copy = deepcopy(loss)
        copy.set_keys(**(renamed if before else {"value": renamed["value"]}))
        copy.make_value_estimator(estimator)
        copy.set_keys(**renamed)
        assert vars(copy.tensor_keys) == renamed
        for name in KEYS.keys() - {"state_action_value", "priority", "priority_weight"}:
            assert getattr(copy.value_estimator.tensor_keys, name) == renamed[name]
        assert ("next", "renamed", "reward") in copy.in_keys
        assert ("next", "reward") not in copy.in_keys
        copy.set_keys(reward=None)
        assert copy.value_estimator.tensor_keys.reward == "reward"


@pytest.mark.parametrize("estimator", [*SUPPORTED, None])
def test_tensordict_run(estimator):
    data = make_data(reward="reward_2", done=("over", "done"), terminated=("over", "terminated"))
    network = make_network(value_key="value_2", action_value_key="q_2")
    loss = make_loss(network)
    loss.set_keys(
        value="value_2",
        state_action_value="q_2",
        priority="error_2",
        reward="reward_2",
        done=("over", "done"),
        terminated=("over", "terminated"),
    )
    if estimator is not None:
        loss.make_value_estimator(estimator)
    with unchanged(data):
        loss(data)
    assert "error_2" in data.keys()  # noqa: SIM118 -- a tensordict is not iterable by key
    params = loss.value_network_params
    loss.value_estimator(data, params=params, target_params=loss.target_value_network_params)
    assert data["advantage"].shape == (8, 1)


def test_notensordict():
    loss = make_loss()
    data = make_data()
    kwargs = {
        "observation": data["observation"],
        "action": data["action"],
        "next_observation": data["next", "observation"],
        "next_reward": data["next", "reward"],
        "next_done": data["next", "done"],
        "next_terminated": data["next", "terminated"],
    }
    names = {key if isinstance(key, str) else "_".join(key) for key in loss.in_keys}
    assert names == {*kwargs, "priority_weight"}
    torch.testing.assert_close(loss(**kwargs), loss(data)["loss"])
    loss.select_out_keys("loss")
    torch.testing.assert_close(loss(**kwargs), loss(data)["loss"])


@pytest.mark.parametrize("reduction", [None, "none", "mean", "sum"])
@pytest.mark.parametrize("loss_function", ["l1", "l2", "smooth_l1"])
def test_reduction(reduction, loss_function):
    loss = make_loss(reduction=reduction, loss_function=loss_function)
    data = make_data(3, 4)
    value = loss(data)["loss"]
    error = data["td_error"].sqrt()
    rows = {
        "l1": error,
        "l2": error.square(),
        "smooth_l1": torch.where(error < 1, error.square() / 2, error - 0.5),
    }[loss_function]
    expected = {"none": rows, "sum": rows.sum()}.get(reduction, rows.mean())
    torch.testing.assert_close(value, expected)


@pytest.mark.parametrize("weight_shape", [(6,), (6, 1)])
def test_prioritized_weights(weight_shape):
    loss = make_loss()
    data = make_data(6)
    plain = loss(data)["loss"]
    error = data["td_error"].clone()
    weights = torch.rand(6) + 0.1
    data["priority_weight"] = weights.reshape(weight_shape)
    torch.testing.assert_close(loss(data)["loss"], (weights * error).sum() / weights.sum())
    ignoring = make_loss(loss.value_network, use_prioritized_weights=False)
    torch.testing.assert_close(ignoring(data)["loss"], plain)
    assert "priority_weight" not in ignoring.in_keys


def test_reset_parameters_recursive():
    loss = make_loss()
    with torch.no_grad():
        for params in (loss.value_network_params, loss.target_value_network_params):
            for value in params.values(True, True):
                value += 1000
    loss.reset_parameters_recursive()
    for params in (loss.value_network_params, loss.target_value_network_params):
        for name in ("value", "factor_logits"):
            assert all(v.abs().max() < 1 for v in params[name].values(True, True))
        # The initial outputs come back, too.
        assert params["factor_logits", "bias_1"].flatten().tolist() == [0.5, 0.5, 0.0]


def test_gamma_and_network_are_checked():
    with pytest.raises(TypeError, match="make_value_estimator"):
        NAFLoss(make_network(), gamma=0.9)
    with pytest.raises(TypeError, match="NAFNetwork"):
        NAFLoss(nn.Linear(5, 1))


def test_value_estimator_class_and_instance():
    loss = make_loss()
    expected = loss.make_value_estimator(gamma=0.5)(data := make_data())["loss"]
    by_class = loss.make_value_estimator(TD0Estimator, gamma=0.5, value_network=None)
    torch.testing.assert_close(by_class(data)["loss"], expected)
    estimator = TD0Estimator(gamma=0.5, value_network=None)
    assert loss.make_value_estimator(estimator).value_estimator is estimator
    torch.testing.assert_close(loss(data)["loss"], expected)


@pytest.mark.parametrize("delay_value", [False, True])
def test_module_cast(delay_value):
    loss = make_loss(delay_value=delay_value)
    data = make_data()
    single = loss(data)["loss"]
    loss.double()
    double = loss(data.apply(lambda x: x.double() if x.is_floating_point() else x))["loss"]
    assert single.dtype is torch.float32
    assert double.dtype is torch.float64
    torch.testing.assert_close(double.float(), single)
    assert {p.dtype for p in loss.parameters()} == {torch.float64}


def test_docstring():
    assert doctest.testmod(marl_lanes.naf.loss).attempted
    assert not doctest.testmod(marl_lanes.naf.loss).failed


@pytest.mark.parametrize("has_tables", [True, False])
@pytest.mark.parametrize("mu", ["paper", "mlp"])
def test_parameters_are_exchanged_only_where_the_network_has_others(mu, has_tables, monkeypatch):
    monkeypatch.setattr(torch_internals, "HAS_TABLES", has_tables)
    loss = NAFLoss(make_paper_network(mu))
    exchange, exchanged = TensorDictParams.to_module, []

    def note(params, *args, **kwargs):
        exchanged.append(params)
        return exchange(params, *args, **kwargs)

    monkeypatch.setattr(TensorDictParams, "to_module", note)
    params, network = loss.value_network_params, loss.value_network

    def exchanges():
        exchanged.clear()
        with loss._parameters_in_place():
            pass
        return sum(one is params for one in exchanged)

    assert exchanges() == 0
    own = network.box.low
    network.box.low = own.clone()
    assert exchanges() == 1
    network.box.low = own
    assert exchanges() == 0
    network.value.bias_0 = nn.Parameter(network.value.bias_0.detach().clone())
    assert exchanges() == 1
