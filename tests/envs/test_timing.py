"""The wall time of steps and resets."""

from marl_lanes.envs.timing import timed


class Slow:
    seconds = 0.0

    @timed
    def step(self, number):
        return sum(range(number))


def test_the_time_of_all_calls_is_added():
    slow = Slow()
    assert slow.step(10_000) == 49_995_000
    first = slow.seconds
    assert 0.0 < first < 10.0
    slow.step(10_000)
    assert slow.seconds > first
    assert Slow.seconds == 0.0
