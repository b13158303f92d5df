"""The structures of mu by name: car following, its correction, and two actions composed."""

import itertools
import math
import re

import pytest
import torch
from naf.paper_networks import call, make_observation, stir
from naf.two_actions import (
    COMPOSED,
    FEATURES,
    HIGH,
    LATERAL,
    LONGITUDINAL,
    LOW,
    composed,
    make_network,
)
from torch import nn

from marl_lanes.naf.mu import ComposedMu


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


@composed
def test_action_and_slope_have_a_column_for_each_part(mu):
    mu = stir(make_network(mu)).mu
    observation = make_observation(7)
    action, slope = mu.act(observation, observation)
    assert torch.equal(action, mu(observation, observation))
    slopes = [part.act(observation, observation)[1] for part in (mu.lateral, mu.longitudinal)]
    assert slope.T.tolist() == [part.flatten().tolist() for part in slopes]


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
