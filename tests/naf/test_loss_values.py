"""What NAFLoss computes: masks, targets, the training stages, target updates, compiled or not."""

import pytest
import torch
from naf.helpers import make_data, make_loss, make_network, unchanged
from tensordict import TensorDict
from torch import nn
from torchrl.objectives import HardUpdate, SoftUpdate, ValueEstimators

from marl_lanes.naf import NAFLoss


def make_group_data(roads=3, agents=4):
    flat = make_data(roads, agents)
    mask = torch.rand(roads, agents) < 0.5
    mask[0, :2] = torch.tensor([True, False])
    group = flat.select("observation", "action").set("mask", mask)
    following = flat["next"]
    return TensorDict({"changers": group, "next": {"changers": following}}, [roads])


def test_group_keys_and_mask():
    network = make_network(
        observation_key=("changers", "observation"),
        action_key=("changers", "action"),
        greedy_action_key=("changers", "greedy_action"),
        value_key=("changers", "state_value"),
        action_value_key=("changers", "state_action_value"),
    )
    loss = make_loss(network)
    loss.set_keys(
        value=("changers", "state_value"),
        state_action_value=("changers", "state_action_value"),
        reward=("changers", "reward"),
        done=("changers", "done"),
        terminated=("changers", "terminated"),
        priority=("changers", "td_error"),
    )
    loss.loss_mask_key = ("changers", "mask")
    data = make_group_data()
    with unchanged(data):
        value = loss(data)["loss"]
    mask = data["changers", "mask"]
    error = data["changers", "td_error"]
    assert error.shape == mask.shape
    torch.testing.assert_close(value, error[mask].mean())

    # Absent agents have no influence on the gradients, either.
    gradients = torch.autograd.grad(value, list(loss.parameters()))
    data["next", "changers", "reward"][~mask] = 1e6
    value = loss(data)["loss"]
    torch.testing.assert_close(value, error[mask].mean())
    for expected, found in zip(
        gradients, torch.autograd.grad(value, list(loss.parameters())), strict=True
    ):
        torch.testing.assert_close(found, expected)

    # A road's weight holds for each of its agents.
    weights = torch.rand(3)
    data["priority_weight"] = weights
    each = weights[:, None].expand_as(mask)[mask]
    torch.testing.assert_close(loss(data)["loss"], (each * error[mask]).sum() / each.sum())


def set_values(loss, value, target):
    """Make V the same in all states."""
    with torch.no_grad():
        for params, constant in (
            (loss.value_network_params, value),
            (loss.target_value_network_params, target),
        ):
            params["value"].apply_(lambda p: p.zero_())
            params["value", "bias_1"].fill_(constant)


def set_greedy_action(loss, data):
    greedy = loss.value_network(data.select("observation"))["greedy_action"]
    data["action"] = greedy.detach()


def test_truncation_bootstraps_and_termination_does_not():
    loss = make_loss().make_value_estimator(gamma=0.9)
    set_values(loss, 2.0, target=-3.0)
    data = make_data(3)
    set_greedy_action(loss, data)  # Q(s, a) = V(s) = 2
    data["next", "reward"] = torch.full((3, 1), 0.5)
    data["next", "terminated"] = torch.tensor([[False], [False], [True]])
    data["next", "truncated"] = torch.tensor([[False], [True], [False]])
    data["next", "done"] = torch.tensor([[False], [True], [True]])
    output = loss(data)
    bootstrapped = (0.5 + 0.9 * -3.0 - 2.0) ** 2
    expected = torch.tensor([bootstrapped, bootstrapped, (0.5 - 2.0) ** 2])
    torch.testing.assert_close(data["td_error"], expected)
    torch.testing.assert_close(output["loss"], expected.mean())


def test_target_is_the_maximum_even_where_mu_leaves_the_box():
    class Outside(nn.Module):
        def forward(self, observation, normalised):  # noqa: ARG002
            return torch.full_like(observation[..., :1], 3.0)

    network = make_network(actions=1)
    network.mu = Outside()
    loss = make_loss(network).make_value_estimator(gamma=1.0)
    data = make_data(4, actions=1)
    loss(data)
    grid = torch.linspace(-1, 1, 201).view(-1, 1, 1).expand(-1, 4, 1)
    following = data["next", "observation"].expand(201, 4, -1)
    q = network(TensorDict({"observation": following, "action": grid}, [201, 4]))
    target = data["next", "reward"] + q["state_action_value"].amax(0)
    own = network(data.select("observation", "action"))["state_action_value"]
    torch.testing.assert_close(data["td_error"], (own - target).square().squeeze(-1))


@pytest.mark.parametrize("mu", ["paper", "damped", "mlp"])
@pytest.mark.parametrize("how", ["flag", "requires_grad", "optimiser"])
def test_stage_one_leaves_mu_alone(mu, how):
    network = make_network(actions=1, mu=mu)
    loss = NAFLoss(network)
    updater = SoftUpdate(loss, tau=0.1)
    trained = loss.parameters()
    if how == "flag":
        network.mu_frozen = True
    elif how == "requires_grad":
        network.mu.requires_grad_(False)
    else:
        trained = [*network.factor_logits.parameters(), *network.value.parameters()]
    optimiser = torch.optim.AdamW(trained, lr=1e-2)

    def train():
        for _ in range(5):
            loss(make_data(actions=1))["loss"].backward()
            optimiser.step()
            optimiser.zero_grad()
            updater.step()

    before = {name: value.clone() for name, value in network.state_dict().items()}
    train()
    moved = {n for n, value in network.state_dict().items() if not torch.equal(value, before[n])}
    assert moved == {n for n in before if n.startswith(("factor_logits", "value"))}

    if how == "flag":  # stage two moves all of them, the target's as well
        network.mu_frozen = False
        target = loss.target_value_network_params["mu"].clone()
        train()
        for name, parameter in network.mu.named_parameters():
            assert not torch.equal(parameter, before[f"mu.{name}"])
            key = tuple(name.split("."))
            assert not torch.equal(target[key], loss.target_value_network_params["mu"][key])


def test_updaters():
    loss = NAFLoss(make_network())
    hard = HardUpdate(loss, value_network_update_interval=2)
    with torch.no_grad():
        for parameter in loss.parameters():
            parameter += 1
    hard.step()
    key = ("value", "bias_0")
    online, target = loss.value_network_params, loss.target_value_network_params
    assert not torch.equal(online[key], target[key])
    hard.step()
    hard.step()  # TorchRL copies once the interval has passed, not when it ends
    assert all(torch.equal(online[k], target[k]) for k in online.keys(True, True))
    soft = SoftUpdate(loss, tau=0.25)
    before = target[key].clone()
    with torch.no_grad():
        online[key].add_(1)
    soft.step()
    torch.testing.assert_close(target[key], before + 0.25)
    with pytest.raises(RuntimeError, match="target parameters"):
        SoftUpdate(NAFLoss(make_network(), delay_value=False), tau=0.1)


# tensordict asks for an option that torch has retired.
@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:torch._dynamo.config.inline_inbuilt_nn_modules:FutureWarning")
@pytest.mark.parametrize("estimator", [ValueEstimators.TD0, ValueEstimators.TDLambda])
def test_compile(estimator):
    torch.compiler.reset()
    loss = make_loss().make_value_estimator(estimator)
    data = make_data(4, 5)
    expected = loss(data.clone())["loss"]
    compiled = torch.compile(loss, backend="eager", fullgraph=True)
    value = compiled(data)["loss"]
    torch.testing.assert_close(value, expected)
    value.backward()
    assert all(p.grad.norm() > 0 for p in loss.parameters())


def test_observations_get_no_gradient():
    loss = make_loss()
    data = make_data()
    data["observation"].requires_grad_()
    data["next", "observation"].requires_grad_()
    loss(data)["loss"].backward()
    assert data["observation"].grad is None
    assert data["next", "observation"].grad is None
    assert not data["td_error"].requires_grad


@pytest.mark.parametrize("mu", ["paper", "damped", "mlp"])
def test_action_value_and_max_value_are_what_forward_writes(mu):
    actions = 2 if mu == "mlp" else 1
    network = make_network(actions, mu=mu)
    loss = make_loss(network)
    data = make_data(actions=actions)
    whole = network(data.select("observation", "action"))
    value = network.action_value(data["observation"], data["action"])
    torch.testing.assert_close(value, whole["state_action_value"])
    torch.testing.assert_close(network.max_value(data["observation"]), whole["state_value"])
    # With another's parameters, and its own are as they were.
    before = {name: p.clone() for name, p in network.named_parameters()}
    target = loss.target_value_network_params
    for name in before:
        target[tuple(name.split("."))].add_(0.1)
    there = network.max_value(data["observation"], target)
    with target.to_module(network, preserve_module_state=False):
        expected = network(data.select("observation"))["state_value"]
    torch.testing.assert_close(there, expected)
    assert not torch.allclose(there, whole["state_value"])
    assert all(torch.equal(before[name], p) for name, p in network.named_parameters())


def test_the_losss_parameters_count_where_the_network_has_others():
    loss = make_loss()
    data = make_data()
    other = make_loss()
    expected = other(data)["loss"].detach()
    assert not torch.isclose(loss(data)["loss"], expected)
    loss.value_network_params = other.value_network_params
    loss.target_value_network_params = other.target_value_network_params
    own = [p.clone() for p in loss.value_network.parameters()]
    output = loss(data)["loss"]
    torch.testing.assert_close(output, expected)
    output.backward()
    assert all(torch.equal(a, b) for a, b in zip(own, loss.value_network.parameters(), strict=True))
    assert all(p.grad is None for p in loss.value_network.parameters())
    assert all(p.grad.norm() > 0 for p in other.value_network.parameters())
    # The buffers, too: here the network reads its features on another scale.
    with torch.no_grad():
        loss.value_network.normalise.scale = loss.value_network.normalise.scale * 3
    torch.testing.assert_close(loss(data)["loss"], expected)


def test_steps_that_span_several_transitions_are_discounted_as_such():
    loss = make_loss().make_value_estimator(gamma=0.5)
    data = make_data()
    one = loss(data)["loss"]
    data["steps_to_next_obs"] = torch.ones(8, 1, dtype=torch.int64)
    torch.testing.assert_close(loss(data)["loss"], one)
    data["steps_to_next_obs"] += 1
    assert not torch.isclose(loss(data)["loss"], one)


def test_td_lambda_mixes_the_returns_of_all_lengths():
    loss = make_loss().make_value_estimator(ValueEstimators.TDLambda, gamma=0.5, lmbda=0.5)
    set_values(loss, 2.0, target=4.0)
    data = make_data(1, 2)
    set_greedy_action(loss, data)
    data["next", "reward"] = torch.tensor([[[1.0], [3.0]]])
    data["next", "done"] = torch.tensor([[[False], [True]]])
    loss(data)
    last = 3.0 + 0.5 * 4.0
    first = 1.0 + 0.5 * (0.5 * 4.0 + 0.5 * last)
    expected = torch.tensor([[(2.0 - first) ** 2, (2.0 - last) ** 2]])
    torch.testing.assert_close(data["td_error"], expected)


def test_rewards_are_standardised_where_the_estimator_says_so():
    loss = make_loss()
    loss.make_value_estimator(ValueEstimators.TD0, gamma=0.5, average_rewards=True)
    set_values(loss, 2.0, target=4.0)
    data = make_data(2)
    set_greedy_action(loss, data)
    data["next", "reward"] = torch.tensor([[1.0], [3.0]])  # 2 -+ 1, deviation sqrt(2)
    loss(data)
    torch.testing.assert_close(data["td_error"], torch.tensor([0.5, 0.5]))


@pytest.mark.parametrize("names", [["reward"], ["reward", "done", "terminated"]])
def test_entries_of_another_shape_are_refused(names):
    data = make_data()
    for name in names:
        data["next", name] = data["next", name].squeeze(-1)
    with pytest.raises(RuntimeError, match="must share a unique shape"):
        make_loss()(data)


def test_priorities_are_written_into_transitions_that_have_some():
    data = make_data()
    data["td_error"] = torch.zeros(8)
    make_loss()(data.lock_())
    assert (data["td_error"] > 0).all()
