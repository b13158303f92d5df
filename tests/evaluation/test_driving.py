from itertools import islice

import numpy as np
import pytest

from marl_lanes.evaluation.driving import drive
from marl_lanes.scenario import ScenarioError
from marl_lanes.traffic import simulator as simulator_module
from marl_lanes.traffic.simulator import Simulator


def test_the_policy_gets_the_observations_of_those_that_act_and_its_actions_are_taken():
    simulator = Simulator("paper", 3, seed=1)
    simulator.reset()
    seen = []

    def policy(observations):
        seen.append(observations.copy())
        return np.full((len(observations), 1), 0.25)

    for _ in drive(simulator, policy):
        acting = simulator.is_acting
        if acting.sum() > 1:
            break
    wanted = simulator.state.observations[acting].copy()
    envs, slots = np.nonzero(acting)
    before = len(seen)
    next(drive(simulator, policy))
    assert len(seen) == before + 1
    np.testing.assert_array_equal(seen[-1], wanted)
    np.testing.assert_array_equal(simulator.actions[envs, slots], 0.25)
    assert simulator.actions.sum() == 0.25 * len(wanted)


def test_the_policy_is_asked_only_for_the_next_step():
    simulator = Simulator("paper", 1, seed=1)
    simulator.reset()
    calls = []

    def policy(observations):
        calls.append(int(simulator.roads["step"][0]))
        return np.zeros((len(observations), 1))

    for _ in islice(drive(simulator, policy), 300):
        was_asked = bool(calls) and calls[-1] == simulator.roads["step"][0] - 1
        assert not calls or calls[-1] < simulator.roads["step"][0]
        if was_asked:
            break
    assert was_asked


def test_where_agents_are_needed_a_day_without_one_is_an_error(monkeypatch):
    monkeypatch.setattr(simulator_module, "MAX_WAIT", 20.0)
    overrides = {"departures": {"interval": [1e6, 1e6]}, "horizon": None}

    def steps(*, needs_agents):
        simulator = Simulator("paper", 2, overrides=overrides)
        simulator.reset()
        unused = drive(simulator, lambda seen: seen, needs_agents=needs_agents)
        return sum(1 for _ in islice(unused, 300))

    assert steps(needs_agents=False) == 300
    with pytest.raises(ScenarioError, match="no agent has become live in 20 s"):
        steps(needs_agents=True)
