"""What holds on every road, in drawn scenarios with drawn actions."""

from collections import Counter

import numpy as np
import pytest
from drawn_scenarios import drawn, share_of
from hypothesis import given
from hypothesis import strategies as st
from invariants import Watch

from marl_lanes.traffic.machine.state import Outcome

NUM_STEPS = 150


def play(case, num_envs):
    """Watch every step of a batch; its actions, the bytes after them, and what happened."""
    simulator = case.simulator(num_envs, num_threads=1)
    watch, generator = Watch(simulator), np.random.default_rng(case.seed)
    given_actions, middle = [], b""
    for step in range(NUM_STEPS):
        if step == NUM_STEPS // 2:
            middle = simulator.snapshot()
        actions, behind = case.choose(simulator, generator)
        given_actions.append((actions, behind if case.has_learner else None))
        simulator.step(*given_actions[-1])
        watch.check()
    met = Counter({name: int(simulator.roads[name].sum()) for name in simulator.roads.dtype.names})
    met.update(outcome.name for known in watch.commands for _, _, outcome in known.values())
    return given_actions, middle, simulator, met


def replay(simulator, given_actions, rows=slice(None)):
    """The same actions once more, or those of some roads; every byte afterwards."""
    for actions, behind in given_actions:
        simulator.step(actions[rows], behind if behind is None else behind[rows])
    return simulator.snapshot()


def hold(number, *, is_whole):
    met = Counter()

    @share_of(number, is_whole=is_whole)
    @given(drawn(), st.sampled_from([3, 16] if is_whole else [3]))
    def keep(case, num_envs):
        given_actions, middle, simulator, happened = play(case, num_envs)
        met.update(happened)
        last = simulator.snapshot()
        assert replay(case.simulator(num_envs, num_threads=3), given_actions) == last
        simulator.restore(middle)
        assert replay(simulator, given_actions[NUM_STEPS // 2 :]) == last
        for road in range(3):
            single = case.simulator(1, first_road=road)
            replay(single, given_actions, slice(road, road + 1))
            for one, many in zip(single.state.arrays, simulator.state.arrays, strict=True):
                assert one[0].tobytes() == many[road].tobytes()

    keep()
    return met


def test_what_holds_after_every_step():
    hold(4, is_whole=False)


@pytest.mark.long
def test_what_holds_after_every_step_of_hundreds_of_scenarios():
    met = hold(200, is_whole=True)
    assert min(met[name] for name in ("num_left", "num_collided", "num_off_road")) > 20
    assert min(met[outcome.name] for outcome in Outcome) > 20
