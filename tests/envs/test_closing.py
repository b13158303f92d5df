"""Environments in a with statement."""

import pytest

from marl_lanes import LaneChangeEnv, env, parallel_env
from marl_lanes.envs.closing import Closes


def test_the_end_of_the_block_closes():
    class Counting(Closes):
        closed = 0

        def close(self):
            self.closed += 1

    with Counting() as counting:
        assert counting.closed == 0
    assert counting.closed == 1
    with pytest.raises(KeyError), counting:
        raise KeyError
    assert counting.closed == 2


@pytest.mark.parametrize("options", [{}, {"population": "constant"}, {"normalised": True}])
def test_every_form_is_closed_twice(options):
    with parallel_env(seed=0, **options) as road:
        road.reset()
    road.close()
    with LaneChangeEnv(seed=0) as roads:
        roads.reset()
    with env(seed=0, **options) as cycle:
        cycle.reset()
    cycle.close()
