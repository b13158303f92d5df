"""Two actions: the composed structures of mu, and Q with the term that couples both."""

import itertools
import math
import re

import numpy as np
import pytest
import torch
from naf.helpers import make_loss
from naf.paper_networks import OFFSETS, SCALES, call, make_observation, stir
from tensordict import TensorDict
from torch import nn

from marl_lanes.naf import NAFNetwork
from marl_lanes.naf.lateral import CascadeMu, DampedMu, PaperMu
from marl_lanes.naf.mu import CarFollowingMu, ComposedMu, MLPMu

FEATURES = [
    "speed",
    "car_following_acceleration",
    "lateral_deviation",
    "yaw",
    "yaw_rate",
    "curvature",
]
LOW, HIGH = [-0.5, -3.0], [0.5, 2.0]
HALF_RANGE = np.array([0.5, 2.5])
LATERAL = {"cascade": CascadeMu, "paper": PaperMu, "damped": DampedMu}
LONGITUDINAL = {"idm": CarFollowingMu, "mlp": MLPMu}
COMPOSED = [f"{first}+{second}" for first in LATERAL for second in LONGITUDINAL]

composed = pytest.mark.parametrize("mu", COMPOSED)
every = pytest.mark.parametrize("mu", [*COMPOSED, "mlp"])


def make_network(mu="paper+idm", low=LOW, high=HIGH, features=FEATURES, **kwargs):
    options = {"hidden_sizes": (16, 16), "offsets": OFFSETS, "scales": SCALES, **kwargs}
    return NAFNetwork(features, low, high, mu=mu, **options)


def make_action(*batch):
    low, high = torch.tensor(LOW), torch.tensor(HIGH)
    return low + (high - low) * torch.rand(*batch, 2)


def observe_prior(prior):
    """Observations, (len(prior), 6), with these accelerations of car following."""
    observation = make_observation(len(prior))
    observation[:, FEATURES.index("car_following_acceleration")] = torch.as_tensor(prior)
    return observation


def car_following(prior, correction):
    """The part `idm` with the correction x instead of its network, and its gradient in x."""

    class Given(nn.Module):
        def forward(self, normalised):  # noqa: ARG002
            return x

    x = torch.as_tensor(correction)[:, None].requires_grad_()
    part = make_network().mu.longitudinal
    part.correction = Given()
    action = part(observe_prior(prior), None)
    action.sum().backward()
    return action.detach().squeeze(-1), x.grad.squeeze(-1)


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


@composed
def test_each_part_acts_on_its_own_dimension(mu):
    network = stir(make_network(mu))
    first, second = mu.split("+")
    assert type(network.mu) is ComposedMu
    assert type(network.mu.lateral) is LATERAL[first]
    assert type(network.mu.longitudinal) is LONGITUDINAL[second]
    assert network.mu.inside_box
    assert network.mu.needs == LATERAL[first].needs + LONGITUDINAL[second].needs
    observation = make_observation(30)
    found = call(network, observation)["greedy_action"]
    lateral = make_network(first, LOW[:1], HIGH[:1])
    lateral.mu.load_state_dict(network.mu.lateral.state_dict())
    torch.testing.assert_close(found[:, :1], call(lateral, observation)["greedy_action"])
    if second == "mlp":
        longitudinal = make_network(second, LOW[1:], HIGH[1:])
        longitudinal.mu.load_state_dict(network.mu.longitudinal.state_dict())
        torch.testing.assert_close(found[:, 1:], call(longitudinal, observation)["greedy_action"])


def test_car_following_and_its_correction():
    priors, corrections = [-9.0, -3.0, -1.0, 0.0, 1.5, 2.0, 7.0], [-1e30, -20, -0.7, 0.0, 0.4, 1e30]
    pairs = list(itertools.product(priors, corrections))
    action, gradient = car_following(*map(list, zip(*pairs, strict=True)))
    for (prior, x), found, slope in zip(pairs, action.tolist(), gradient.tolist(), strict=True):
        p = min(max(prior, -3.0), 2.0)
        room = min(2.0 - p, 1.0) if x > 0 else min(p + 3.0, 1.0)
        assert found == pytest.approx(p + math.tanh(x) * room, abs=1e-6)
        assert slope == pytest.approx((1 - math.tanh(x) ** 2) * room, abs=1e-5)


@pytest.mark.parametrize(("low", "high"), [(-3.0, 2.0), (-0.1, 0.7), (0.3, 1.1), (-7.3, -0.9)])
def test_the_correction_reaches_its_own_bound_and_the_boxs_and_no_further(low, high):
    network = make_network(low=[-0.5, low], high=[0.5, high])
    prior = torch.cat([torch.linspace(low - 1, high + 1, 301), torch.tensor([low, high])])
    for scale in (0.1, 1.0, 10.0, 1e4):
        raw = stir(network, scale).mu.longitudinal(observe_prior(prior), make_observation(303))
        assert (raw >= network.box.low[1]).all()
        assert (raw <= network.box.high[1]).all()
    clipped = prior.clamp(low, high)
    for extreme, correction in ((-1e30, -1.0), (1e30, 1.0)):
        with torch.no_grad():
            network.mu.longitudinal.correction.last_bias.fill_(extreme)
        found = call(network, observe_prior(prior))["greedy_action"][:, 1]
        assert torch.equal(found, (clipped + correction).clamp(low, high))


def test_the_correction_has_a_gradient_toward_the_room_that_is_left():
    _, inside = car_following([-2.9, 0.0, 1.9] * 3, [-1.0] * 3 + [0.0] * 3 + [1.0] * 3)
    assert (inside > 0.02).all()
    _, on_a_bound = car_following([-5.0, 5.0], [0.1, -0.1])
    assert (on_a_bound > 0.98).all()
    _, against_a_bound = car_following([-5.0, 5.0], [-0.1, 0.1])
    assert (against_a_bound == 0).all()


def test_initial_composed_mu():
    prior = torch.linspace(-6.0, 5.0, 45)
    observation = observe_prior(prior)
    for first in LATERAL:
        with_idm = call(make_network(f"{first}+idm"), observation)["greedy_action"][:, 1]
        torch.testing.assert_close(with_idm, prior.clamp(-3.0, 2.0), atol=0.1, rtol=0)
        with_mlp = call(make_network(f"{first}+mlp"), observation)["greedy_action"][:, 1]
        torch.testing.assert_close(with_mlp, torch.full((45,), -0.5), atol=0.1, rtol=0)


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
    data = call(network, make_observation(5), make_action(5))
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


@composed
def test_a_missing_column_is_named(mu):
    for feature in make_network(mu).mu.needs:
        features = [name for name in FEATURES if name != feature]
        message = re.escape(f"mu '{mu}' needs the feature '{feature}'")
        with pytest.raises(ValueError, match=message):
            make_network(mu, features=features, offsets=None, scales=None)


@pytest.mark.parametrize(
    "mu", ["idm", "paper+", "+idm", "paper+damped", "mlp+idm", "paper+idm+mlp", "paper + idm", ""]
)
def test_an_unknown_name_lists_those_allowed(mu):
    allowed = ", ".join([*LATERAL, *COMPOSED, "mlp"])
    with pytest.raises(ValueError, match=re.escape(f"unknown mu '{mu}', allowed: {allowed}") + "$"):
        make_network(mu)


@pytest.mark.parametrize("actions", [1, 2, 3])
def test_a_name_for_another_number_of_actions(actions):
    allowed = {1: [*LATERAL, "mlp"], 2: [*COMPOSED, "mlp"], 3: ["mlp"]}[actions]
    for mu in {*LATERAL, *COMPOSED, "mlp"} - set(allowed):
        start, end = f"mu '{mu}' gives ", f" has {actions}; allowed: {', '.join(allowed)}"
        with pytest.raises(ValueError, match=f"^{re.escape(start)}.*{re.escape(end)}$"):
            make_network(mu, [-1.0] * actions, [1.0] * actions)
    for mu in allowed:
        assert make_network(mu, [-1.0] * actions, [1.0] * actions).action_dim == actions


def test_only_the_yaw_acceleration_needs_zero_inside_its_bounds():
    with pytest.raises(ValueError, match=r"'paper\+idm' needs .* zero inside, got \[0.1, 0.5\]"):
        make_network(low=[0.1, -3.0], high=[0.5, 2.0])
    make_network(low=[-0.5, 0.5], high=[0.5, 2.0])
