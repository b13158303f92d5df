"""A constant population against the live one: the same road, with every agent in every dict."""

from functools import partial

import numpy as np
import pytest
from pettingzoo.test import api_test, parallel_api_test

from marl_lanes import env, parallel_env
from marl_lanes.traffic.machine.state import Outcome

GOES_ON = {Outcome.UNFINISHED, Outcome.HORIZON}
LONG = 100_000
FEW = {"num_agents": 3, "command": {"probability": 1.0}}
HASTY = {"num_agents": 3, "command": {"probability": 1.0, "time_limit": 2.0}}


def play(road, seed):
    """What reset and steps of an episode return, and which agents were live before each step."""
    observations, infos = road.reset(seed=seed)
    none = {}
    frames = [([], observations, none, none, none, infos)]
    while road.agents:
        before = list(road.agents)
        frames.append((before, *road.step({agent: np.zeros(1) for agent in before})))
    return frames


@pytest.mark.parametrize(
    ("overrides", "max_cycles", "has_followers"),
    [
        (FEW, None, False),
        (HASTY, None, True),
        ({**FEW, "num_agents": 60, "horizon": 40.0}, None, False),
        (FEW, 20, True),
    ],
)
def test_it_is_the_same_road_with_the_absent_ones_masked(overrides, max_cycles, has_followers):
    make = partial(
        parallel_env,
        "dense",
        overrides=overrides,
        seed=0,
        max_cycles=max_cycles,
        learned_followers=has_followers,
    )
    constant, live = make(population="constant"), make()
    play(constant, 1)
    ended, current = set(), set()
    frames = [play(road, 7) for road in (constant, live)]
    names = constant.possible_agents
    is_cut = "horizon" in overrides or max_cycles is not None
    for (_, *parts), (_, *fewer) in zip(*frames, strict=True):
        observations, rewards, terminations, truncations, infos = parts
        # Who is live when the episode is cut goes on: a learner bootstraps from what it sees.
        ended |= {
            name
            for name in fewer[4]
            if fewer[4][name.replace("follower", "changer")]["outcome"] not in GOES_ON
        }
        current = set(fewer[4]) - ended
        assert list(observations) == list(infos) == names
        for name in names:
            assert constant.observation_space(name).contains(observations[name])
            *row, is_unborn, is_live, has_ended = observations[name].tolist()
            assert (is_live, has_ended) == (name in current, name in ended)
            assert is_unborn + is_live + has_ended == 1.0
            assert infos[name]["is_live"] == is_live
            assert row == (fewer[0][name].tolist() if is_live else [0.0] * len(row))
            told = {key: value for key, value in infos[name].items() if key != "is_live"}
            assert told == fewer[4].get(name, dict.fromkeys(told, 0.0))
            assert rewards.get(name, 0.0) == fewer[1].get(name, 0.0)
        is_last = observations is frames[0][-1][1]
        if rewards:
            assert set(terminations.values()) == {is_last and not is_cut}
            assert set(truncations.values()) == {is_last and is_cut}
    assert constant.agents == []
    assert (len(ended) < len(names)) == is_cut
    assert bool(current) == is_cut


def test_who_has_ended_before_a_snapshot_has_ended():
    road = parallel_env("dense", population="constant", overrides=FEW, seed=0)
    before, _ = road.reset(seed=1)
    while not before["changer_0"][-1]:
        before, *_ = road.step({name: np.zeros(1) for name in road.agents})
    again, _ = road.reset(options={"snapshot": road.unwrapped.simulator.snapshot()})
    assert {name: row.tolist() for name, row in again.items()} == {
        name: row.tolist() for name, row in before.items()
    }


@pytest.mark.parametrize("normalised", [False, True])
def test_it_passes_pettingzoos_tests(normalised):
    options = {"population": "constant", "normalised": normalised, "overrides": FEW, "seed": 0}
    parallel_api_test(parallel_env("dense", **options), num_cycles=LONG)
    api_test(env("dense", **options), num_cycles=300)


def test_actions_of_agents_that_are_not_live_are_ignored():
    road, twin = (
        parallel_env("dense", population="constant", overrides=FEW, seed=0) for _ in range(2)
    )
    _, infos = road.reset()
    twin.reset()
    strays = {name: np.nan for name, info in infos.items() if not info["is_live"]}
    live = {name: 0.1 for name, info in infos.items() if info["is_live"]}
    assert strays
    assert live
    assert repr(road.step({**strays, **live})) == repr(twin.step(live))
    with pytest.raises(ValueError, match=r"is live and has no action"):
        road.step({})


@pytest.mark.filterwarnings("ignore:PettingZoo in TorchRL is tested using version:UserWarning")
def test_it_runs_in_torchrls_wrapper():
    from torchrl.envs import PettingZooWrapper
    from torchrl.envs.utils import check_env_specs

    road = parallel_env("dense", population="constant", overrides=FEW, seed=0)
    wrapped = PettingZooWrapper(road, done_on_any=False)
    check_env_specs(wrapped)
    steps = wrapped.rollout(LONG)
    done = steps["next", "done"].flatten()
    assert done.tolist() == [False] * (len(done) - 1) + [True]
    assert road.simulator.roads["is_done"][0] == 1
    live, outcome = (steps["changer", "info", key] for key in ("is_live", "outcome"))
    assert (steps["next", "changer", "info", "outcome"] > 0).sum(0).flatten().tolist() == [1] * 3
    assert not (live.bool() & (outcome > 0)).any()
