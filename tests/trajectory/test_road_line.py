import math

import numpy as np
import pytest

from marl_lanes import load_scenario
from marl_lanes.trajectory.road_line import RoadLine


def line(*arcs, length=1000.0):
    return RoadLine(load_scenario("paper", {"road": {"length": length, "arcs": list(arcs)}}))


def test_a_straight_road_is_straight():
    x, y, heading = line().place([0.0, 123.4, 1100.0], [1.0, 5.6, 2.0])
    assert x == pytest.approx([0.0, 123.4, 1100.0])
    assert y == pytest.approx([1.0, 5.6, 2.0])
    assert (heading == 0.0).all()


@pytest.mark.parametrize("sign", [1, -1])
def test_an_arc_without_clothoids_is_a_circle(sign):
    """A quarter of a circle of 200 m: it ends at (200, 200), headed 90 degrees to the left."""
    quarter = 0.5 * math.pi * 200.0
    road = line({"start": 0.0, "end": quarter, "radius": sign * 200.0, "transition": 0.0})
    x, y, heading = road.place([quarter], [0.0])
    assert x == pytest.approx([200.0], abs=0.3)
    assert y == pytest.approx([sign * 200.0], abs=0.3)
    assert heading == pytest.approx([sign * 0.5 * math.pi], abs=2e-3)
    # A place 3 m to the left of the edge is nearer to the centre of a left curve.
    x, y, _ = road.place([0.5 * quarter], [3.0])
    assert math.hypot(x[0], y[0] - sign * 200.0) == pytest.approx(200.0 - sign * 3.0, abs=0.3)


def test_a_clothoid_turns_half_as_much_as_an_arc():
    road = line({"start": 100.0, "end": 300.0, "radius": 500.0, "transition": 100.0})
    _, _, heading = road.place([100.0, 200.0, 300.0], [0.0] * 3)
    assert heading == pytest.approx([0.0, 50.0 / 500.0, 100.0 / 500.0], abs=1e-5)


def test_the_line_has_the_length_of_the_road():
    road = line({"start": 100.0, "end": 900.0, "radius": 300.0})
    along = np.linspace(0.0, 1000.0, 4001)
    x, y, _ = road.place(along, np.zeros_like(along))
    assert np.hypot(np.diff(x), np.diff(y)).sum() == pytest.approx(1000.0, abs=0.01)
    # Nothing jumps.
    assert np.hypot(np.diff(x), np.diff(y)).max() < 0.26


def test_the_left_lane_of_a_left_curve_is_shorter():
    road = line({"start": 0.0, "end": 1000.0, "radius": 400.0, "transition": 0.0})
    along = np.linspace(0.0, 1000.0, 2001)
    x, y, _ = road.place(along, np.full_like(along, 8.0))
    length = np.hypot(np.diff(x), np.diff(y)).sum()
    assert length == pytest.approx(1000.0 * (400.0 - 8.0) / 400.0, abs=0.1)
