"""The PettingZoo environment: agents from command to outcome, their actions, rewards and ends."""

import itertools
from collections import Counter

import numpy as np
import pytest
import torch
from envs.playing import BUSY, hold, play, steer, until_engaged

from marl_lanes import ScenarioError, env, list_scenarios, parallel_env
from marl_lanes.traffic.machine.state import Outcome, Phase

torch.set_num_threads(1)

TERMS = ("reward_yaw_acceleration", "reward_yaw_rate", "reward_deviation", "reward_failure")
TERMS += ("reward_delay", "reward_longitudinal")
TERMINATING = {Outcome.COMPLETED, Outcome.COLLISION, Outcome.OFF_ROAD}
TRUNCATING = {Outcome.MISSED, Outcome.HORIZON, Outcome.TIMED_OUT}


def random_policy(seed):
    rng = np.random.default_rng(seed)
    return lambda _: rng.uniform(-0.5, 0.5, 1).astype(np.float32)


@pytest.mark.parametrize("scenario", list_scenarios())
def test_an_episode_is_its_commands_each_born_and_finished_once(scenario):
    road = parallel_env(scenario, seed=0)
    live, ended, idle_steps = [], [], 0
    for before, _, _, terminations, truncations, infos in play(road, seed=1):
        assert sorted(live) == sorted(before)
        newborn = sorted(set(infos) - set(before), key=road.possible_agents.index)
        assert set(before) <= set(infos)
        over = [name for name in infos if terminations[name] or truncations[name]]
        assert not set(newborn) & set(live + ended + over)
        ended += over
        live = [name for name in live + newborn if name not in over]
        idle_steps += not set(before) - set(over)
    assert Counter(ended) == Counter(road.possible_agents)
    assert not live
    assert road.possible_agents == [f"changer_{k}" for k in range(10)]
    assert road.simulator.roads["is_done"][0] == 1


def test_idle_traffic_is_run_through():
    road = parallel_env(seed=0)
    observations, _ = road.reset(seed=0)
    skipped = 0
    while road.agents:
        before = int(road.simulator.roads["step"][0])
        observations = road.step({agent: steer(observations[agent]) for agent in road.agents})[0]
        assert road.agents or road.simulator.roads["is_done"][0]
        assert sorted(road.agents, key=road.possible_agents.index) == road.agents
        skipped += int(road.simulator.roads["step"][0]) - before > 1
    assert skipped > 3


def test_the_horizon_truncates_every_live_agent():
    road = parallel_env(overrides={**BUSY, "horizon": 20.0, "num_agents": 1000}, seed=0)
    before, _, _, terminations, truncations, infos = play(road, hold, seed=0)[-1]
    outcomes = [infos[agent]["outcome"] for agent in before]
    assert outcomes.count(Outcome.HORIZON) > 1
    assert road.simulator.roads["step"][0] == 200
    assert all(terminations[agent] != truncations[agent] for agent in before)
    assert road.is_cut


def test_max_cycles_truncates_the_live_agents():
    road = parallel_env("dense", seed=0, max_cycles=7)
    for _ in range(2):
        *steps, last = play(road, hold)
        assert len(steps) == 7
        assert not any(any(frame[4].values()) for frame in steps)
        assert all(last[4][name] for name in last[0])
        assert not any(last[3].values())
        assert road.is_cut
        assert road.step({}) == ({}, {}, {}, {}, {})


def test_an_episode_to_its_last_command_is_not_cut():
    road = parallel_env("dense", seed=0, overrides={"num_agents": 2})
    play(road)
    assert not road.is_cut


@pytest.mark.parametrize("population", ["live", "constant"])
def test_after_the_end_a_step_returns_empty_dicts(population):
    road = parallel_env(overrides={"num_agents": 1}, population=population, seed=0)
    assert road.step({}) == ({}, {}, {}, {}, {})
    play(road, hold, seed=0)
    last = road.simulator.state.tobytes()
    assert road.step({"changer_0": hold(None)}) == ({}, {}, {}, {}, {})
    assert road.simulator.state.tobytes() == last
    assert road.metadata["name"] == "lane_change_v0"


def test_a_newborn_is_in_every_dict_with_reward_zero():
    born = 0
    road = parallel_env("dense", overrides={**BUSY, "num_agents": 30}, seed=0)
    for before, observations, rewards, terminations, truncations, infos in play(road, hold, seed=2):
        names = set(infos)
        assert before == sorted(before, key=road.possible_agents.index)
        assert all(set(part) == names for part in (observations, rewards, terminations))
        assert set(truncations) == names
        for name in names - set(before):
            born += 1
            assert rewards[name] == 0.0
            assert not terminations[name]
            assert not truncations[name]
            assert infos[name]["phase"] in {Phase.WAITING, Phase.ENGAGED}
    assert born == 30


@pytest.mark.parametrize("policy", [steer, hold, random_policy(0)])
def test_rewards_are_the_sum_of_the_terms_and_only_steering_pays(policy):
    road = parallel_env("dense", overrides={"num_agents": 30}, seed=0)
    phases, paid = {}, 0
    for before, _, rewards, _, _, infos in play(road, policy, seed=4):
        for name in before:
            info = infos[name]
            terms = [info[term] for term in TERMS]
            assert rewards[name] == pytest.approx(sum(terms), abs=1e-12)
            assert max(terms) <= 0.0
            is_failure = info["outcome"] in {Outcome.COLLISION, Outcome.OFF_ROAD}
            assert info["reward_failure"] == (-10.0 if is_failure else 0.0)
            if phases[name] == Phase.WAITING:
                assert rewards[name] == info["reward_failure"]
            else:
                paid += rewards[name] < 0.0
        phases.update({name: info["phase"] for name, info in infos.items()})
    assert paid > 100


def test_outcomes_agree_with_terminations_and_truncations():
    seen = set()
    cases = itertools.product(["dense", "paper"], [steer, hold, random_policy(0)])
    limits = {"dense": {"command": {"time_limit": 15.0}}, "paper": {}}
    for scenario, policy in cases:
        overrides = {"num_agents": 40, "horizon": 60.0, **limits[scenario]}
        road = parallel_env(scenario, overrides=overrides, seed=0)
        for _, _, _, terminations, truncations, infos in play(road, policy, seed=0):
            for name, info in infos.items():
                outcome = info["outcome"]
                assert terminations[name] == (outcome in TERMINATING)
                assert truncations[name] == (outcome in TRUNCATING)
                assert (info["phase"] == Phase.ABSENT) == (outcome != Outcome.UNFINISHED)
                seen.add(Outcome(int(outcome)))
    assert seen == set(Outcome)


@pytest.mark.parametrize(
    ("action", "problem"),
    [
        (None, "must be real numbers"),
        (np.zeros((1, 2)), r"must be \(1,\)"),
        (np.zeros(2), r"must be \(1,\)"),
        (np.zeros(0), r"must be \(1,\)"),
        (np.array([np.nan]), "must be finite"),
        (np.array([np.inf]), "must be finite"),
    ],
)
def test_a_bad_action_is_refused_by_the_agents_name(action, problem):
    road, twin = parallel_env(seed=0), parallel_env(seed=0)
    until_engaged(road)
    until_engaged(twin)
    (agent,) = road.agents
    with pytest.raises(ValueError, match=rf"actions\['{agent}'\].*{problem}"):
        road.step({agent: action})
    # The rejected step has changed nothing.
    fine = {agent: np.array([0.1], np.float32)}
    assert repr(road.step(fine)) == repr(twin.step(fine))


def test_a_missing_action_is_refused_by_the_agents_name():
    road = parallel_env(overrides=BUSY, seed=0)
    road.reset(seed=0)
    while len(road.agents) < 2:
        road.step({agent: hold(None) for agent in road.agents})
    with pytest.raises(ValueError, match=rf"{road.agents[1]} is live and has no action"):
        road.step({road.agents[0]: hold(None)})


def test_actions_are_clipped_and_those_of_others_ignored():
    road, twin = parallel_env(seed=0), parallel_env(seed=0)
    until_engaged(road)
    until_engaged(twin)
    (agent,) = road.agents
    strays = {"changer_9": np.full(3, np.nan), "nobody": None}
    clipped = twin.step({agent: [0.5]})
    assert repr(road.step({agent: [1e30], **strays})) == repr(clipped)
    assert clipped[4][agent]["reward_yaw_acceleration"] == -1.0


@pytest.mark.parametrize("scenario", list_scenarios())
def test_long_random_rollouts_stay_in_the_spaces(scenario):
    road = parallel_env(scenario, overrides={"num_agents": 10}, seed=0)
    for name in road.possible_agents:
        assert road.action_space(name) is road.action_space(name)
        assert road.observation_space(name) is road.observation_space(name)
        road.action_space(name).seed(0)
    observations, _ = road.reset(seed=6)
    rows = []
    while road.agents:
        for name, seen in observations.items():
            assert road.observation_space(name).contains(seen), seen
        rows += observations.values()
        actions = {name: road.action_space(name).sample() for name in road.agents}
        observations = road.step(actions)[0]
    spread = np.ptp(np.stack(rows), axis=0)
    is_curved = bool(road.scenario.road.arcs)
    features = road.scenario.observation.features
    assert (spread > 0.0).tolist() == [is_curved or name != "curvature" for name in features]


@pytest.mark.parametrize("population", ["live", "constant"])
def test_returned_observations_are_nobody_elses(population):
    few = {"num_agents": 4}
    road, twin = (
        parallel_env("dense", population=population, overrides=few, seed=0) for _ in range(2)
    )
    kept, saved = [road.reset(seed=0)[0]], []
    twin.reset(seed=0)
    while road.agents:
        saved.append(repr(kept[-1]))
        actions = {agent: hold(None) for agent in road.agents}
        kept.append(road.step(actions)[0])
        written_over = twin.step(actions)[0]
        assert repr(written_over) == repr(kept[-1])
        for seen in written_over.values():
            seen.fill(1.0)
    assert [repr(observations) for observations in kept[:-1]] == saved


def test_the_state_is_bounded_and_flat_on_request():
    road, flat = (parallel_env(seed=0, has_flat_state=flat) for flat in (False, True))
    road.reset()
    flat.reset()
    assert flat.state_space.is_bounded()
    assert flat.state_space.contains(flat.state())
    assert flat.state().shape == (64 * 7,)
    assert np.array_equal(flat.state(), road.state().ravel())


def test_what_cannot_be_is_refused():
    for form in (parallel_env, env):
        with pytest.raises(ScenarioError, match=r"needs num_agents \(is None\)"):
            form(overrides={"num_agents": None})
        with pytest.raises(ScenarioError, match=r"command\.probability > 0 \(is 0\.0\)"):
            form(overrides={"command": {"probability": 0.0}})
        with pytest.raises(ScenarioError, match=r"followers\.mix: 'rude' has no policy; allowed: "):
            form(overrides={"followers": {"mix": {"rude": 1.0}}})
        with pytest.raises(ScenarioError, match="no such scenario"):
            form("nowhere")
    with pytest.raises(ValueError, match="seed = -1"):
        parallel_env().reset(seed=-1)
