"""The structures of mu: initial values, bounds, and lane changes that they make."""

import math

import pytest
import torch
from naf.paper_networks import (
    OFFSETS,
    PAPER,
    SCALES,
    call,
    make_network,
    make_observation,
    state,
    stir,
)
from tensordict import TensorDict

from marl_lanes.naf import NAFNetwork
from marl_lanes.naf.lateral import DampedMu, PaperMu


def test_initial_paper_mu():
    mu = make_network("paper").mu
    v, dev, psi = 22.0, 3.75, 0.03
    observation = torch.stack(
        [state(lateral_deviation=dev, yaw=psi), state(lateral_deviation=-1.0), state(yaw=-0.02)]
    )
    normalised = (observation - torch.tensor(OFFSETS)) / torch.tensor(SCALES)
    demands = torch.tensor([dev / 3.4**2 - v * psi / 3.4, -1 / 3.4**2, v * 0.02 / 3.4])
    expected = 0.25 * torch.tanh(0.31 * demands)
    found = mu(observation, normalised).squeeze(-1)
    torch.testing.assert_close(found, expected, rtol=0.05, atol=0)
    # The transition time never falls below 1.5 s.
    with torch.no_grad():
        mu.heads.last_bias[2].fill_(-1e30)
        mu.heads.last_bias[1].fill_(math.log(math.expm1(0.31)))
    found = mu(observation, normalised)[1]
    expected = 0.25 * math.tanh(0.31 * -1 / 1.5**2)
    assert found.item() == pytest.approx(expected, rel=0.05)


def test_initial_damped_mu():
    mu = make_network("damped").mu
    observation = torch.stack(
        [
            state(lateral_deviation=0.5, yaw=0.01, yaw_rate=0.004),
            state(speed=0.3, lateral_deviation=0.02),
            state(yaw_rate=0.022, curvature=0.001),
        ]
    )
    p = 1.4
    demands = [p**3 * 0.5 / 22 - 3 * p**2 * 0.01 - 3 * p * 0.004, p**3 * 0.02 / 1.0, 0.0]
    expected = [0.17 * math.tanh(demand / 0.17) for demand in demands]
    normalised = (observation - torch.tensor(OFFSETS)) / torch.tensor(SCALES)
    found = mu(observation, normalised).squeeze(-1)
    torch.testing.assert_close(found, torch.tensor(expected), rtol=0.05, atol=1e-4)


@pytest.mark.parametrize("mu", ["paper", "damped"])
@pytest.mark.parametrize(("low", "high"), [(-0.1, 0.1), (-0.05, 0.5), (-3.0, 3.0)])
def test_structured_mu_keeps_to_the_box(mu, low, high):
    network = NAFNetwork(PAPER, [low], [high], mu=mu, scales=SCALES, offsets=OFFSETS)
    observation = make_observation(200) * 10
    observation[:, PAPER.index("lateral_deviation")].abs_()
    initial = call(network, observation)["greedy_action"].abs().max().item()
    bound = min(-low, high)
    expected = {"paper": PaperMu, "damped": DampedMu}[mu].initial_a_max
    expected = min(expected, 0.9 * bound)
    if mu == "damped":
        expected = max(expected, min(0.03 * 1.4**3 + 0.01 * bound, bound))
    assert initial == pytest.approx(expected, rel=0.05)
    raw = stir(network, 3.0).mu(observation, network.normalise(observation))
    assert (raw >= low).all()
    assert (raw <= high).all()


def lane_change(network, seconds=60.0, dt=0.1, speed=22.0, deviation=3.75, yaw=0.0):
    """The lateral deviations of a vehicle under the greedy policy, semi-implicit Euler."""
    policy = network.policy()
    yaw_rate = 0.0
    deviations = []
    for _ in range(round(seconds / dt)):
        observation = state(lateral_deviation=deviation, yaw=yaw, yaw_rate=yaw_rate)
        with torch.no_grad():
            action = policy(TensorDict({"observation": observation}))["action"].item()
        yaw_rate += action * dt
        yaw += yaw_rate * dt
        deviation -= speed * yaw * dt
        deviations.append(deviation)
    return deviations


def test_damped_mu_settles_and_the_papers_does_not():
    damped = lane_change(make_network("damped"))
    assert max(map(abs, damped[150:])) < 0.01
    assert min(damped) > -0.5
    paper = lane_change(make_network("paper"), deviation=0.1)
    assert min(paper[:100]) < 0  # it reaches the centre of the lane
    assert max(map(abs, paper[-100:])) > 1.0  # and oscillates ever more widely about it


@pytest.mark.parametrize("poles", [-1e30, 1e30])
def test_damped_mu_settles_at_the_ends_of_its_gains(poles):
    network = make_network("damped")
    with torch.no_grad():
        network.mu.heads.last_bias[1:].fill_(poles)
    assert max(map(abs, lane_change(network)[-100:])) < 0.01


@pytest.mark.parametrize("poles", [-1e30, 0.0, 1.0, 1e30])
def test_damped_mu_brings_a_turned_back_vehicle_home(poles):
    network = make_network("damped")
    with torch.no_grad():
        network.mu.heads.last_bias[0].fill_(-1e30)
        network.mu.heads.last_bias[1:].fill_(poles)
    # At the marking, 1.1 m/s outward: to the road's edge it has 3.8 m more.
    deviations = lane_change(network, deviation=-0.9, yaw=0.05)
    assert min(deviations) > -4.7
    assert max(deviations) < 2.0
    assert max(map(abs, deviations[-100:])) < 0.05
