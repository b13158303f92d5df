"""Integration of a vehicle's motion along the road."""

import math

import numpy as np
import pytest
from staging import advance, one_arc, place

from marl_lanes.traffic.simulator import Simulator


def test_one_step_by_hand():
    simulator = Simulator("paper", seed=0)
    car = place(simulator, acceleration=2.0, yaw=0.1, yaw_rate=0.2, yaw_acceleration=0.5)
    advance(simulator, car, is_keeping=False)
    assert car["speed"] == pytest.approx(20.2)
    assert car["yaw_rate"] == pytest.approx(0.25)
    assert car["yaw"] == pytest.approx(0.125)
    assert car["position"] == pytest.approx(2.02 * math.cos(0.125))
    assert car["lateral_position"] == pytest.approx(1.875 + 2.02 * math.sin(0.125))
    assert car["lane_low"] == 0
    assert car["lane_high"] == 0


def test_vehicles_stop_and_do_not_reverse():
    simulator = Simulator("paper", seed=0)
    car = place(simulator, speed=0.3, acceleration=-8.0, yaw=0.05, yaw_rate=0.01)
    advance(simulator, car)
    assert (car["speed"], car["position"], car["lateral_position"]) == (0.0, 0.0, 1.875)
    assert car["yaw_rate"] == 0.0


def test_the_yaw_rate_is_bounded_by_the_turning_radius():
    simulator = Simulator("paper", seed=0)
    for sign in (1.0, -1.0):
        car = place(simulator, speed=2.0, yaw_rate=sign * 0.1, yaw_acceleration=sign * 100.0)
        advance(simulator, car, is_keeping=False)
        assert car["yaw_rate"] == pytest.approx(sign * 2.0 / 5.5)
        assert car["yaw_acceleration"] == pytest.approx(sign * (2.0 / 5.5 - 0.1) / 0.1)


def test_accelerations_in_the_state_are_those_applied():
    """(after - before)/dt of speed and of yaw rate, also while stopping and at a standstill."""
    simulator = Simulator("interactive", 4, seed=2, overrides={"num_agents": None, "horizon": None})
    generator = np.random.default_rng(2)
    simulator.reset()
    num_asked_for_more = 0
    for _ in range(400):
        before = simulator.vehicles.copy()
        actions = generator.uniform(-0.5, 0.5, (*simulator.agents.shape, 2))
        # Half of the agents brake to a standstill.
        actions[:, ::2, 1] = -3.0
        simulator.step(actions)
        is_same = (before["id"] == simulator.vehicles["id"]) & (before["id"] >= 0)
        old, new = before[is_same], simulator.vehicles[is_same]
        for name, rate in (("speed", "acceleration"), ("yaw_rate", "yaw_acceleration")):
            assert new[rate] == pytest.approx((new[name] - old[name]) / 0.1, abs=1e-9)
        num_asked_for_more += int(((new["speed"] == 0.0) & (new["agent"] >= 0)).sum())
    assert num_asked_for_more > 100


@pytest.mark.parametrize("radius", [150.0, -150.0, 1e9])
def test_the_road_frame_agrees_with_the_plane(radius):
    """The same yaw rates integrated in Cartesian coordinates give the same position."""
    step = 0.01
    simulator = one_arc(radius, time_step=step)
    car = place(simulator, lateral_position=3.0, speed=15.0, yaw_rate=15.0 / radius)
    # The origin is the centre of the right edge's circle; the vehicle begins on the y axis.
    x, y, heading = 0.0, 3.0 - radius, 0.0
    for count in range(600):
        car["yaw_acceleration"] = 0.1 * math.sin(0.01 * count)
        advance(simulator, car, is_keeping=False)
        heading += car["yaw_rate"] * step
        x += 15.0 * math.cos(heading) * step
        y += 15.0 * math.sin(heading) * step
    angle = math.atan2(x, -y) if radius > 0 else math.atan2(x, y)
    distance = radius - math.copysign(math.hypot(x, y), radius)
    assert car["position"] == pytest.approx(abs(radius) * angle, abs=0.05)
    assert car["lateral_position"] == pytest.approx(distance, abs=0.05)
    assert car["yaw"] == pytest.approx(heading - angle * math.copysign(1.0, radius), abs=0.002)
    assert abs(car["lateral_position"] - 3.0) > 1.0


@pytest.mark.parametrize("radius", [60.0, 500.0])
def test_mirrored_arcs_give_mirrored_motion(radius):
    """Lane 0 to the left of the edge and lane -1 to its right are mirror images."""
    left, right = one_arc(radius), one_arc(-radius)
    car = place(left, yaw=0.02, yaw_rate=-0.01, lateral_position=2.2)
    image = place(right, yaw=-0.02, yaw_rate=0.01, lateral_position=-2.2, lane=-1)
    for _ in range(200):
        advance(left, car)
        advance(right, image)
        assert image["position"] == car["position"]
        for name in ("lateral_position", "yaw", "yaw_rate", "yaw_acceleration"):
            assert image[name] == -car[name], name
