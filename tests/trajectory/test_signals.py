import pytest
from pictures import commanded, make_frame

from marl_lanes.traffic.machine.state import Fate, Outcome, Phase
from marl_lanes.trajectory.signals import are_braking, are_commanded, are_lost, find_indicators


@pytest.mark.parametrize("direction", [1, -1])
def test_a_changer_indicates_to_the_side_that_it_goes_to(direction):
    phases = (Phase.WAITING, Phase.ENGAGED, Phase.ABORTING)
    rows = make_frame(*(commanded(1.0, direction=direction, phase=phase) for phase in phases)).rows
    assert find_indicators(rows).tolist() == [direction, direction, -direction]


def test_who_moves_over_indicates_and_others_do_not():
    ended = commanded(3.0, phase=Phase.ABSENT, outcome=Outcome.COMPLETED)
    rows = make_frame({"moving_over": -1}, {"moving_over": 0}, ended).rows
    assert find_indicators(rows).tolist() == [-1, 0, 0]
    assert are_commanded(rows).tolist() == [False, False, True]


def test_brake_lights_are_on_below_the_limit():
    rows = make_frame(*({"acceleration": value} for value in (-0.6, -0.5, 0.0, 1.0))).rows
    assert are_braking(rows).tolist() == [True, False, False, False]


def test_who_leaves_at_the_roads_end_is_not_lost():
    rows = make_frame(*({"fate": fate} for fate in Fate)).rows
    assert are_lost(rows).tolist() == [False, False, True, True]
