"""Two actions: the composed structures of mu, and Q with the term that couples both."""

import itertools

import numpy as np
import pytest
import torch
from naf.helpers import make_loss
from naf.paper_networks import call, make_observation, stir
from naf.two_actions import (
    FEATURES,
    HALF_RANGE,
    HIGH,
    LOW,
    composed,
    every,
    make_action,
    make_network,
)
from tensordict import TensorDict

from marl_lanes.naf import NAFNetwork


@every
def test_q_is_the_plain_quadratic_form(mu):
    network = stir(make_network(mu))
    observation, action = make_observation(7, 5), make_action(7, 5)
    data = call(network, observation, action)
    factor = network.cholesky(observation)
    assert (data["greedy_action"].shape, factor.shape) == ((7, 5, 2), (7, 5, 2, 2))
    arrays = (factor, data["greedy_action"], action, data["state_value"])
    lower, greedy, taken, value = (array.detach().double().numpy() for array in arrays)
    scale = np.diag(1 / HALF_RANGE)
    expected = np.empty((7, 5, 1))
    for index in np.ndindex(7, 5):
        matrix = scale @ -(lower[index] @ lower[index].T) @ scale
        assert np.linalg.eigvalsh(matrix).max() < 0
        assert abs(matrix[0, 1]) > 1e-4
        assert matrix[0, 1] == matrix[1, 0]
        distance = greedy[index] - taken[index]
        expected[index] = distance @ matrix @ distance + value[index]
    found = data["state_action_value"].detach().numpy()
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-5)


def test_the_coupling_of_both_actions_has_a_gradient():
    network = make_network()
    observation, action = make_observation(20), make_action(20)
    call(network, observation, action)["state_action_value"].sum().backward()
    diagonal, coupling = network.factor_logits.last_bias.grad.flatten().split([2, 1])
    assert coupling.abs() > 1e-3
    assert (diagonal.abs() > 1e-3).all()


def test_a_diagonal_m_couples_nothing():
    network = stir(make_network(off_diagonal=False))
    assert network.factor_logits.last_bias.numel() == 2
    observation = make_observation(9)
    factor = network.cholesky(observation)
    assert torch.equal(factor, torch.diag_embed(factor.diagonal(dim1=-2, dim2=-1)))
    greedy = call(network, observation)["greedy_action"]
    step = torch.tensor([[0.3, 0.0], [0.0, 0.3], [0.3, 0.3]]) * torch.tensor(HALF_RANGE).float()
    at_mu = network.max_value(observation)
    losses = [at_mu - network.action_value(observation, greedy + one) for one in step]
    torch.testing.assert_close(losses[0] + losses[1], losses[2])
    assert NAFNetwork(**network.config).off_diagonal is False


@pytest.mark.slow
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_the_coupling_of_both_actions_is_learned(sign):
    network = make_network("damped+idm")
    network.mu_frozen = True
    optimizer = torch.optim.Adam(network.parameters(), 1e-2)
    target = torch.tensor([[-1.0, 0.5 * sign], [0.5 * sign, -1.0]])
    for _ in range(150):
        observation, action = make_observation(64), make_action(64)
        data = call(network, observation, action)
        distance = (data["greedy_action"].detach() - action) / torch.tensor(HALF_RANGE).float()
        q = torch.einsum("bi,ij,bj->b", distance, target, distance)[:, None] + 2.0
        loss = (data["state_action_value"] - q).square().mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    factor = network.cholesky(make_observation(50))
    matrix = -(factor @ factor.mT).mean(0)
    torch.testing.assert_close(matrix, target, atol=0.1, rtol=0)


@every
def test_greedy_action_is_the_maximum_over_the_box(mu):
    network = stir(make_network(mu))
    observation = make_observation(3)
    lines = [torch.linspace(low, high, 101) for low, high in zip(LOW, HIGH, strict=True)]
    grid = torch.cartesian_prod(*lines)
    q = call(network, observation.expand(len(grid), 3, -1), grid.unsqueeze(1).expand(-1, 3, 2))[
        "state_action_value"
    ]
    data = call(network, observation)
    assert (q <= data["state_value"] + 1e-6).all()
    at_greedy = call(network, observation, data["greedy_action"].detach())
    torch.testing.assert_close(at_greedy["state_action_value"], data["state_value"])
    torch.testing.assert_close(network.max_value(observation), data["state_value"])


@every
@pytest.mark.parametrize("size", [1e5, 1e15, 1e30])
def test_extreme_observations(mu, size):
    network = stir(make_network(mu))
    rows = list(itertools.product([-size, 0.0, size], repeat=len(FEATURES)))
    observation = torch.tensor(rows)
    data = call(network, observation, make_action(len(rows)))
    for key in network.out_keys:
        assert data[key].isfinite().all(), key
    action = data["greedy_action"]
    assert (action >= torch.tensor(LOW)).all()
    assert (action <= torch.tensor(HIGH)).all()
    if size <= 1e15:  # beyond it the demand of a lateral formula overflows
        (data["state_action_value"].sum() + action.sum()).backward()
        assert all(parameter.grad.isfinite().all() for parameter in network.parameters())


@composed
@pytest.mark.parametrize("extreme", [1e30, -1e30])
def test_gradients_are_finite_at_extreme_logits(mu, extreme):
    network = make_network(mu)
    with torch.no_grad():
        network.mu.lateral.heads.last_bias.fill_(extreme)
        network.factor_logits.last_bias.fill_(extreme)
        part = network.mu.longitudinal
        (part.action if mu.endswith("mlp") else part.correction).last_bias.fill_(extreme)
    data = call(network, make_observation(20), make_action(20))
    (data["state_action_value"].sum() + data["greedy_action"].sum()).backward()
    assert data["state_action_value"].isfinite().all()
    assert all(parameter.grad.isfinite().all() for parameter in network.parameters())


@composed
def test_policy_has_the_parameters_of_mu_and_no_others(mu):
    network = stir(make_network(mu))
    policy = network.policy(("changers", "observation"), ("changers", "action"))
    parts = itertools.chain(network.mu.lateral.parameters(), network.mu.longitudinal.parameters())
    own = {id(p) for p in network.mu.parameters()}
    assert {id(p) for p in policy.parameters()} == own == {id(p) for p in parts}
    others = {id(p) for m in (network.factor_logits, network.value) for p in m.parameters()}
    assert not own & others
    assert {id(p) for p in network.parameters()} == own | others
    observation = make_observation(3, 4)
    expected = call(network, observation)["greedy_action"]
    network.factor_logits = network.value = None  # calling either would raise
    data = policy(TensorDict({"changers": {"observation": observation}}, [3]))
    torch.testing.assert_close(data["changers", "action"], expected)


@composed
@pytest.mark.parametrize("is_frozen", [True, False])
def test_mu_frozen_stops_both_parts(mu, is_frozen):
    network = make_network(mu)
    network.mu_frozen = is_frozen
    observation = make_observation(16)
    observation[:8, FEATURES.index("lateral_deviation")] = 3.75  # before the change has begun
    data = call(network, observation, make_action(16))
    data["state_action_value"].sum().backward()
    for name, parameter in network.named_parameters():
        if is_frozen and name.startswith("mu."):
            assert parameter.grad is None, name
        else:
            assert parameter.grad.abs().sum() > 0, name


@every
def test_the_loss_trains_every_network(mu):
    loss = make_loss(make_network(mu))
    observation, action = make_observation(16), make_action(16)
    observation[:8, FEATURES.index("lateral_deviation")] = 3.75  # before the change has begun
    data = TensorDict({"observation": observation, "action": action}, [16])
    data["next"] = TensorDict(
        {
            "observation": make_observation(16),
            "reward": torch.randn(16, 1),
            "done": torch.zeros(16, 1, dtype=torch.bool),
            "terminated": torch.zeros(16, 1, dtype=torch.bool),
        },
        [16],
    )
    loss(data)["loss"].backward()
    gradients = [p.grad for p in loss.parameters() if p.requires_grad]
    assert len(gradients) == len(list(make_network(mu).parameters()))
    assert all(gradient.abs().sum() > 0 for gradient in gradients)


@composed
def test_config_round_trip(mu, tmp_path):
    network = stir(make_network(mu))
    path = tmp_path / "checkpoint.pt"
    torch.save({"config": network.config, "state": network.state_dict()}, path)
    saved = torch.load(path, weights_only=True)
    rebuilt = NAFNetwork(**saved["config"])
    rebuilt.load_state_dict(saved["state"])
    assert rebuilt.config == network.config
    assert rebuilt.config["mu"] == mu
    observation, action = make_observation(4), make_action(4)
    first, second = (call(one, observation, action) for one in (network, rebuilt))
    for key in network.out_keys:
        torch.testing.assert_close(first[key], second[key], rtol=0, atol=0)
