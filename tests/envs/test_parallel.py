"""The PettingZoo environment: PettingZoo's own tests, and whole episodes."""

import copy
import itertools
import warnings
from collections import Counter

import numpy as np
import pytest
import torch

from marl_lanes import ScenarioError, env, list_scenarios, parallel_env
from marl_lanes.envs import parallel
from marl_lanes.traffic.machine.state import Outcome, Phase

with warnings.catch_warnings():
    # With pygame installed, PettingZoo's tests import one of its games in a deprecated way.
    warnings.filterwarnings("ignore", "The old environment creation API", DeprecationWarning)
    from pettingzoo.test import (
        api_test,
        parallel_api_test,
        parallel_seed_test,
        performance_benchmark,
        seed_test,
    )

from pettingzoo.utils import BaseParallelWrapper
from pettingzoo.utils.conversions import aec_to_parallel
from pettingzoo.utils.wrappers import ClipOutOfBoundsWrapper, OrderEnforcingWrapper

torch.set_num_threads(1)

BUSY = {"departures": {"interval": [1.5, 3.0]}, "command": {"probability": 1.0}}
TERMS = ("reward_yaw_acceleration", "reward_yaw_rate", "reward_deviation", "reward_failure")
TERMS += ("reward_delay", "reward_longitudinal")
TERMINATING = {Outcome.COMPLETED, Outcome.COLLISION, Outcome.OFF_ROAD}
TRUNCATING = {Outcome.MISSED, Outcome.HORIZON, Outcome.TIMED_OUT}
LONG = 100_000


def steer(observation):
    """Feedback of the paper's features toward the target lane; it completes most changes.

    Where there are more features, the last but one is what car following would do.
    """
    speed, _, deviation, yaw, yaw_rate, curvature, *others = observation.tolist()
    wanted = min(max(0.5 * deviation, -2.0), 2.0) / max(speed, 1.0)
    action = 2.0 * (wanted - yaw) - 2.0 * (yaw_rate - curvature * speed)
    return np.array([action, *others[-2:-1]], np.float32)


def random_policy(seed):
    rng = np.random.default_rng(seed)
    return lambda _: rng.uniform(-0.5, 0.5, 1).astype(np.float32)


def hold(_):
    return np.zeros(1, np.float32)


POLICIES = {"steer": steer, "hold": hold}


def play(road, policy=steer, **reset):
    """Steps of an episode: the agents before each step, and the results of reset and steps."""
    observations, infos = road.reset(**reset)
    empty = dict.fromkeys(observations, 0.0), dict.fromkeys(observations, False)
    frames = [([], observations, empty[0], empty[1], empty[1], infos)]
    for _ in range(LONG):
        if not road.agents:
            return frames
        before = list(road.agents)
        actions = {agent: policy(observations[agent]) for agent in before}
        observations, *others = road.step(actions)
        frames.append((before, observations, *others))
    raise AssertionError("the episode does not end")


def transcript(road, policy=steer, **reset):
    """Every byte that an episode returns, state() included."""
    observations, infos = road.reset(**reset)
    lines = [repr(infos)]
    while road.agents:
        lines += [f"{name}:{seen.tobytes().hex()}" for name, seen in observations.items()]
        lines.append(road.state().tobytes().hex())
        actions = {agent: policy(observations[agent]) for agent in road.agents}
        observations, *others = road.step(actions)
        lines.append(repr(others))
    return lines


def until_engaged(road, seed=0):
    observations, infos = road.reset(seed=seed)
    while not any(info["phase"] == Phase.ENGAGED for info in infos.values()):
        observations, _, _, _, infos = road.step({agent: hold(None) for agent in road.agents})
    return observations, infos


@pytest.mark.parametrize("scenario", ["paper", "dense", "five_lanes"])
def test_it_passes_the_parallel_api_test(scenario):
    parallel_api_test(parallel_env(scenario, seed=0), num_cycles=LONG)


@pytest.mark.parametrize("scenario", ["paper", "dense"])
def test_its_aec_form_passes_the_api_test(scenario):
    api_test(env(scenario, seed=0), num_cycles=1000)


def test_it_passes_the_tests_without_a_seed():
    parallel_api_test(parallel_env(), num_cycles=LONG)
    api_test(env(overrides={"horizon": 40.0}), num_cycles=200)


def test_it_passes_the_seed_tests():
    seed_test(env)
    parallel_seed_test(parallel_env)


@pytest.mark.slow
def test_its_aec_form_runs_the_performance_benchmark(capsys):
    performance_benchmark(env(seed=0))
    assert "Finished performance benchmark" in capsys.readouterr().out


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


@pytest.mark.parametrize("population", ["live", "constant"])
def test_after_the_end_a_step_returns_empty_dicts(population):
    road = parallel_env(overrides={"num_agents": 1}, population=population, seed=0)
    assert road.step({}) == ({}, {}, {}, {}, {})
    play(road, hold, seed=0)
    last = road.simulator.state.tobytes()
    assert road.step({"changer_0": hold(None)}) == ({}, {}, {}, {}, {})
    assert road.simulator.state.tobytes() == last
    assert road.metadata["name"] == "lane_change_v0"


SHORT = {"horizon": 20.0}
"""Most episodes end before the first command."""


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


def test_the_aec_form_is_used_in_every_order():
    cycle = env("dense", seed=0, overrides={"num_agents": 3})
    with pytest.raises(AttributeError, match="cannot be accessed before reset"):
        cycle.agent_selection  # noqa: B018
    with pytest.raises(AssertionError):
        cycle.step(hold(None))
    for _ in range(2):
        # A reset in the middle of a cycle begins anew.
        cycle.reset(seed=4)
        seen = cycle.last()[0].tobytes()
        for _ in range(7):
            cycle.step(hold(None))
    cycle.reset(seed=4)
    assert cycle.last()[0].tobytes() == seen
    for agent in cycle.agent_iter():
        _, _, terminated, truncated, info = cycle.last()
        cycle.step(None if terminated or truncated else hold(None))
        assert agent.startswith("changer_")
        assert "phase" in info or truncated or terminated or not info
    assert not cycle.agents
    last = cycle.unwrapped.simulator.snapshot()
    cycle.step(None)
    assert cycle.unwrapped.simulator.snapshot() == last
    cycle.close()
    cycle.close()
    cycle.reset(seed=4)
    assert cycle.last()[0].tobytes() == seen


def test_a_refused_action_of_the_aec_form_leaves_the_road():
    cycle = env("dense", seed=0)
    cycle.reset()
    before = cycle.unwrapped.simulator.snapshot()
    with pytest.raises(ValueError, match=r"^actions\['changer_0'\]: shape \(2,\), must be \(1,\)$"):
        cycle.step(np.zeros(2))
    assert cycle.unwrapped.simulator.snapshot() == before
    cycle.step(np.zeros(1))
    assert cycle.unwrapped.simulator.snapshot() != before


def test_pettingzoos_wrappers_change_nothing():
    plain = transcript(parallel_env("dense", overrides={"num_agents": 3}), hold, seed=2)
    wrapped = BaseParallelWrapper(parallel_env("dense", overrides={"num_agents": 3}))
    assert transcript(wrapped, hold, seed=2) == plain
    cycle = OrderEnforcingWrapper(ClipOutOfBoundsWrapper(env("dense", overrides={"num_agents": 3})))
    back = aec_to_parallel(cycle)
    back.reset(seed=2)
    road = parallel_env("dense", overrides={"num_agents": 3})
    road.reset(seed=2)
    while len(road.agents) == 1:
        actions = {agent: np.full(1, 0.1, np.float32) for agent in road.agents}
        assert back.agents == road.agents
        back.step(actions)
        road.step(actions)
        assert back.state().tobytes() == road.state().tobytes()
    assert road.simulator.roads["step"][0] > 0


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


def test_the_state_is_bounded_and_flat_on_request():
    road, flat = (parallel_env(seed=0, has_flat_state=flat) for flat in (False, True))
    road.reset()
    flat.reset()
    assert flat.state_space.is_bounded()
    assert flat.state_space.contains(flat.state())
    assert flat.state().shape == (64 * 7,)
    assert np.array_equal(flat.state(), road.state().ravel())
