"""The road's curvature, the road's turning, and angles."""

import math

import pytest
from staging import one_arc, place

from marl_lanes.traffic.road.geometry import curvature_at, road_turn_rate, wrap_angle
from marl_lanes.traffic.simulator import Simulator


def test_the_curvature_is_a_step_or_rises_and_falls_linearly():
    arcs = [
        {"start": 150.0, "end": 450.0, "radius": 500.0, "transition": 0.0},
        {"start": 550.0, "end": 850.0, "radius": -500.0, "transition": 100.0},
    ]
    found = Simulator("paper", overrides={"road": {"arcs": arcs}}, seed=0).parameters.arcs
    step = {149.99: 0.0, 150.0: 0.002, 449.99: 0.002, 450.0: 0.0}
    ramp = {549.0: 0.0, 550.0: 0.0, 575.0: -0.0005, 649.0: -0.00198, 650.0: -0.002, 750.0: -0.002}
    ramp |= {800.0: -0.001, 849.0: -0.00002, 850.0: 0.0, 999.0: 0.0}
    for position, curvature in (step | ramp).items():
        assert curvature_at(found, position) == pytest.approx(curvature, abs=1e-15), position


@pytest.mark.parametrize(
    ("angle", "wrapped"),
    [
        (0.0, 0.0),
        (-0.3, -0.3),
        (math.pi, math.pi),
        (-math.pi, math.pi),
        (3.96, 3.96 - 2.0 * math.pi),
        (-3.96, 2.0 * math.pi - 3.96),
        (7.0 * math.pi + 0.5, -math.pi + 0.5),
    ],
)
def test_an_angle_is_wrapped_into_one_turn(angle, wrapped):
    assert wrap_angle(angle) == pytest.approx(wrapped, abs=1e-14)


@pytest.mark.parametrize(
    ("lateral", "turning"),
    # c v/(1 - c d) with c = 1/100 and v = 20; beside the road as at d = 50, half the radius.
    [(-20.0, 0.2 / 1.2), (0.0, 0.2), (20.0, 0.25), (60.0, 0.4), (100.0, 0.4), (300.0, 0.4)],
)
def test_the_turning_of_the_road_stays_bounded_beside_it(lateral, turning):
    simulator = one_arc(100.0)
    car = place(simulator, position=100.0, lateral_position=lateral)
    assert road_turn_rate(car, simulator.parameters.arcs) == pytest.approx(turning)
