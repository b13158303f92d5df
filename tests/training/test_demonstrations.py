"""Demonstrations of an expert, and what imitates them."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch
from collecting import BUSY

from marl_lanes import load_scenario
from marl_lanes.traffic.machine.state import Phase
from marl_lanes.training.checkpoint import make_network
from marl_lanes.training.demonstrations import (
    DemonstrationsConfig,
    collect_demonstrations,
    imitate,
    learn_from_expert,
)

SCENARIO = load_scenario("paper", BUSY)
SPEED, DEVIATION, YAW_RATE = 0, 2, 4


def settings(**changes):
    chosen = {"num_transitions": 400, "num_updates": 300, "batch_size": 64, "learning_rate": 0.01}
    others = {"policy": "mpc", "num_rounds": 1, "sigma": 0.2}
    return DemonstrationsConfig(**(chosen | others | changes))


def expert(observations):
    """Smooth, so that a network can learn it; the lane change goes on for the whole road."""
    seen = observations.astype(np.float64)
    return 0.3 * np.tanh(seen[:, [DEVIATION]] / 4.0) - 1.5 * seen[:, [YAW_RATE]]


@pytest.fixture(scope="module")
def shown():
    return collect_demonstrations(SCENARIO, expert, settings(), 5)


def test_the_actions_are_those_of_the_expert_without_noise(shown):
    observations, actions, effective = shown
    assert observations.shape == (400, 6)
    assert actions.shape == (400, 1)
    assert (observations[:, SPEED] > 0).all()
    assert actions.numpy() == pytest.approx(expert(observations.numpy()), abs=1e-6)
    assert effective.shape == (400, 1)
    assert effective.all()


def test_their_memory_is_that_of_all_that_is_seen(monkeypatch):
    monkeypatch.setattr("psutil.virtual_memory", lambda: SimpleNamespace(available=10**6))
    stacked = load_scenario("paper", {"observation": {"num_stacked": 64}})
    problem = r"^demonstrations\.num_transitions = 1000: needs about .* must be at most 324 here$"
    with pytest.raises(ValueError, match=problem):
        collect_demonstrations(stacked, expert, settings(num_transitions=1000), 5)


def test_the_same_seed_has_the_same_demonstrations(shown):
    again = collect_demonstrations(SCENARIO, expert, settings(), 5)
    other = collect_demonstrations(SCENARIO, expert, settings(), 6)
    assert all(torch.equal(*pair) for pair in zip(shown, again, strict=True))
    assert not torch.equal(shown[0], other[0])


def test_noise_brings_the_states_around_the_paths():
    def beginnings(observations):
        near = (observations[:, DEVIATION] - 3.75).abs() < 0.05
        return observations[near, YAW_RATE]

    quiet, *_ = collect_demonstrations(SCENARIO, expert, settings(sigma=0.0), 5)
    assert beginnings(quiet).min() >= 0.0
    loud, *_ = collect_demonstrations(SCENARIO, expert, settings(sigma=1.0), 5)
    assert (beginnings(loud) < 0.0).sum() > 5
    # Clipped to the bound of the action, 0.5 rad/s^2.
    wild, *_ = collect_demonstrations(SCENARIO, expert, settings(sigma=100.0), 5)
    assert beginnings(wild).abs().max() > 0.049
    assert wild[:, YAW_RATE].abs().max() < 0.5


def test_mu_is_fitted_to_them_and_nothing_else(shown):
    torch.manual_seed(0)
    network = make_network(SCENARIO, "mlp", [16])
    before = {name: value.clone() for name, value in network.state_dict().items()}
    untrained = (network.policy().module(shown[0]) - shown[1]).square().mean() / 0.25
    loss = imitate(network, *shown, settings())
    assert loss < 0.01 * untrained
    greedy = network.policy().module(shown[0]).detach()
    assert float((greedy - shown[1]).square().mean() / 0.25) == pytest.approx(loss, rel=0.5)
    changed = {
        name for name, value in network.state_dict().items() if (value != before[name]).any()
    }
    assert changed
    assert all(name.startswith("mu.") for name in changed)


def test_what_has_no_effect_is_not_imitated():
    """A waiting agent's lane keeping steers; its acceleration is its own."""
    traffic = {**BUSY, "warmup": [20.0, 20.0]}
    scenario = load_scenario("interactive", traffic)
    phase = list(scenario.observation.features).index("phase")

    def steering_by_phase(observations):
        waits = observations[:, phase] == Phase.WAITING
        return np.column_stack([np.where(waits, 0.4, -0.1), np.where(waits, -1.0, 1.0)])

    observations, actions, effective = collect_demonstrations(
        scenario, steering_by_phase, settings(sigma=0.0), 5
    )
    waits = observations[:, phase] == Phase.WAITING
    assert 20 < waits.sum() < 380
    assert torch.equal(effective, torch.stack([~waits, torch.ones_like(waits)], 1))
    torch.manual_seed(0)
    network = make_network(scenario, "mlp", [16])
    imitate(network, observations, actions, effective, settings())
    greedy = network.policy().module(observations).detach()
    assert (greedy[~waits, 0] + 0.1).abs().mean() < 0.02
    assert (greedy[waits, 0] - 0.4).abs().mean() > 0.2
    assert (greedy[:, 1] - actions[:, 1]).abs().mean() < 0.2


def test_one_round_is_the_experts_and_an_imitation(shown):
    torch.manual_seed(0)
    network = make_network(SCENARIO, "mlp", [16])
    loss = learn_from_expert(network, SCENARIO, expert, settings(), 5)
    torch.manual_seed(0)
    other = make_network(SCENARIO, "mlp", [16])
    assert loss == imitate(other, *shown, settings())
    assert all(map(torch.equal, network.state_dict().values(), other.state_dict().values()))


def test_in_further_rounds_the_imitation_drives_and_the_expert_tells(monkeypatch):
    """An imitation that has learned nothing stays in its lane; the expert has never left it."""
    fitted = []

    def fit_nothing(_network, observations, actions, effective, _config):
        fitted.append((observations, actions, effective))
        return float(len(fitted))

    monkeypatch.setattr("marl_lanes.training.demonstrations.imitate", fit_nothing)
    network = make_network(SCENARIO, "mlp", [16])
    with torch.no_grad():
        network.mu.action.last_bias.fill_(-1e3)  # hard to the other side
    rounds = settings(num_rounds=3, num_transitions=401, sigma=0.0)
    assert learn_from_expert(network, SCENARIO, expert, rounds, 5) == 3.0
    assert [len(observations) for observations, *_ in fitted] == [134, 267, 401]
    observations, actions, effective = fitted[-1]
    for seen, of_all in zip(fitted[0], fitted[-1], strict=True):
        assert torch.equal(seen, of_all[:134])
    # All actions are the expert's, and the states beyond the first round are mu's.
    assert actions.numpy() == pytest.approx(expert(observations.numpy()), abs=1e-6)
    assert effective.all()
    assert observations[:134, YAW_RATE].max() > 0.05
    assert observations[134:, YAW_RATE].max() <= 0.0
    assert observations[134:, YAW_RATE].min() < -0.05
    # Each round has traffic of its own.
    assert not torch.equal(observations[134:139, SPEED], observations[267:272, SPEED])


@pytest.mark.parametrize("rounds", [2, 7])
def test_a_round_has_transitions(rounds):
    with pytest.raises(
        ValueError, match=rf"num_rounds = {rounds}: must be at most num_transitions = 1 "
    ):
        settings(num_transitions=1, num_rounds=rounds)
    # Without demonstrations it means nothing.
    assert settings(num_transitions=0, num_rounds=rounds).num_transitions == 0


def test_too_many_are_refused_before_anything_drives():
    with pytest.raises(ValueError, match=r"demonstrations\.num_transitions = 1000000000000: needs"):
        collect_demonstrations(SCENARIO, expert, settings(num_transitions=10**12), 0)
