"""Resets of the PettingZoo environment: seeds, skipped episodes, options and snapshots."""

import copy

import numpy as np
import pytest
import torch
from envs.playing import BUSY, hold, play, steer, transcript, until_engaged

from marl_lanes import ScenarioError, env, parallel_env
from marl_lanes.envs import parallel

torch.set_num_threads(1)

POLICIES = {"steer": steer, "hold": hold}
SHORT = {"horizon": 20.0}
"""Most episodes end before the first command."""


@pytest.mark.parametrize("scenario", ["paper", "dense"])
@pytest.mark.parametrize("policy", POLICIES)
def test_a_seed_gives_the_same_bytes_over_a_whole_episode(scenario, policy):
    used = parallel_env(scenario, seed=9)
    play(used)
    first = transcript(parallel_env(scenario, seed=0), POLICIES[policy], seed=3)
    assert first == transcript(used, POLICIES[policy], seed=3)
    assert first == transcript(parallel_env(scenario, seed=3), POLICIES[policy])
    assert first != transcript(used, POLICIES[policy], seed=4)
    assert transcript(used, seed=0) == transcript(parallel_env(scenario, seed=0))


def test_a_reset_without_a_seed_goes_on_in_the_stream():
    one, other = parallel_env(seed=5), parallel_env(seed=0)
    first = [transcript(one), transcript(one), transcript(one)]
    assert len({"".join(lines) for lines in first}) == 3
    assert first == [transcript(other, seed=5), transcript(other), transcript(other)]


def test_an_unused_environment_without_a_seed_draws_one_in_each_copy():
    """Vector environments copy the one that they are given."""
    road = parallel_env()
    assert copy.deepcopy(road).initial_seed != road.initial_seed
    for used in (parallel_env(seed=3), road):
        used.reset()
        assert transcript(copy.deepcopy(used)) == transcript(used)


def test_numpys_generator_follows_the_seed():
    road = parallel_env(seed=3)
    first = road.np_random.random()
    assert road.np_random is road.np_random
    road.reset(seed=4)
    other = road.np_random.random()
    road.reset(seed=3)
    assert road.np_random.random() == first != other


def test_a_reset_goes_on_to_an_episode_with_an_agent():
    first = []
    for seed in range(20):
        road, cycle = parallel_env(overrides=SHORT), env(overrides=SHORT)
        observations, infos = road.reset(seed=seed)
        assert road.agents == ["changer_0"] == list(observations) == list(infos)
        cycle.reset(seed=seed)
        assert cycle.agents == road.agents
        assert cycle.observe("changer_0").tobytes() == observations["changer_0"].tobytes()
        assert 0 <= road.simulator.roads["step"][0] < 200
        first.append(observations["changer_0"].tobytes())
    assert len(set(first)) == 20
    # Without skips the stream is as it was: episodes with an agent have the same bytes as ever.
    again = parallel_env(overrides=SHORT, seed=19)
    assert again.reset()[0]["changer_0"].tobytes() == first[-1]


@pytest.mark.parametrize("form", [parallel_env, env])
def test_where_no_command_can_come_a_reset_gives_up(monkeypatch, form):
    monkeypatch.setattr(parallel, "MAX_SKIPPED", 20)
    road = form("paper", overrides={"horizon": 0.5}, seed=0)
    match = r"^scenario 'paper': horizon = 0\.5: must be longer, no command came in 20 episodes$"
    with pytest.raises(ScenarioError, match=match):
        road.reset()
    with pytest.raises(ScenarioError, match=match):
        road.reset(seed=1)


def test_an_option_changes_the_traffic_of_one_episode():
    road, twin = parallel_env(seed=4), parallel_env(seed=4)
    fuller = {"overrides": {"departures": {"interval": [1.5, 2.0]}}}
    changed = transcript(road, options=fuller)
    usual = transcript(road)
    assert changed == transcript(parallel_env(seed=4, overrides=fuller["overrides"]))
    assert changed != transcript(twin)
    # The next episode has the usual traffic, and other random numbers than those that are used up.
    assert road.scenario == twin.scenario
    assert usual != transcript(parallel_env(seed=4))


def test_an_options_mapping_may_be_used_again_with_other_values():
    road = parallel_env(seed=4)
    changes = {"departures": {"interval": np.array([1.5, 2.0])}}
    road.reset(options={"overrides": changes})
    simulator = road.simulator
    road.reset(options={"overrides": {"departures": {"interval": np.array([1.5, 2.0])}}})
    assert road.simulator is simulator
    changes["departures"]["interval"] = [8.0, 9.0]
    road.reset(options={"overrides": changes})
    assert road.scenario.departures.interval == (8.0, 9.0)


def test_an_option_begins_in_a_snapshot():
    road = parallel_env("dense", seed=0)
    until_engaged(road)
    snapshot = road.simulator.snapshot()
    first, second = (transcript(road, options={"snapshot": snapshot}) for _ in range(2))
    assert first == second
    over = parallel_env("dense", seed=0, overrides={"num_agents": 1})
    play(over)
    with pytest.raises(ValueError, match=r"^options\['snapshot'\]: an agent must become live"):
        over.reset(options={"snapshot": over.simulator.snapshot()})


def test_a_snapshot_of_the_step_that_ended_a_command_begins_with_the_live_agents():
    road = parallel_env("dense", seed=0, overrides=BUSY)
    infos = road.reset(seed=0)[1]
    while len(road.agents) == len(infos) or not road.agents:
        *_, infos = road.step({agent: hold(None) for agent in road.agents})
    observations, infos = road.reset(options={"snapshot": road.simulator.snapshot()})
    assert set(observations) == set(infos) == set(road.agents)


@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        ({"num_agents": 3}, "num_agents, max_vehicles, time_step, observations, actions and"),
        ({"observation": {"features": ["speed"]}}, "the columns of the state must be those"),
        ({"action": {"max_yaw_acceleration": 0.1}}, "the columns of the state must be those"),
        ({"density": 3.0}, "density"),
        ({"command": {"probability": 0.0}}, r"command\.probability > 0"),
    ],
)
def test_overrides_of_a_reset_that_cannot_be(changes, problem):
    road, twin = parallel_env(seed=0), parallel_env(seed=0)
    with pytest.raises(ScenarioError, match=problem):
        road.reset(seed=1, options={"overrides": changes})
    assert transcript(road) == transcript(twin)
