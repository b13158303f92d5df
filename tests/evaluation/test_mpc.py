"""The controller on a receding horizon, compared with the optimum that knows the speeds ahead."""

import math

import numpy as np
import pytest

from marl_lanes import load_scenario
from marl_lanes.evaluation.mpc import FADING, RecedingHorizon
from marl_lanes.evaluation.optimum import optimal_lane_change

PAPER = load_scenario("paper")
CONTROLLER = RecedingHorizon(PAPER)
STEP = PAPER.time_step


def predict(speed, acceleration, num_steps=250):
    times = STEP * np.arange(1, num_steps + 1)
    return np.maximum(0.0, speed + acceleration * FADING * (1.0 - np.exp(-times / FADING)))


@pytest.mark.parametrize("acceleration", [0.0, 1.0, -1.5])
@pytest.mark.parametrize("state", [(3.75, 0.0, 0.0), (2.0, 0.03, 0.02), (-0.5, 0.01, 0.0)])
@pytest.mark.parametrize("name", ["paper", "touch"])
def test_the_plan_is_the_optimum_at_the_predicted_speeds(name, state, acceleration):
    scenario = load_scenario(name)
    cost, actions = RecedingHorizon(scenario).plan(20.0, *state, acceleration)
    deviation, yaw, yaw_rate = state
    optimum = optimal_lane_change(
        scenario,
        predict(20.0, acceleration),
        deviation=deviation,
        yaw=yaw,
        yaw_rate=yaw_rate,
        initial_speed=20.0,
    )
    assert cost == pytest.approx(-optimum.total_return, rel=2e-3)
    assert abs(len(actions) - optimum.num_steps) <= 1


def drive(speed, round_state):
    """Cost until completion at constant speed; the state is rounded before every plan."""
    reward, completion = PAPER.reward, PAPER.completion
    e, psi, w, cost = 3.75, 0.0, 0.0, 0.0
    for count in range(1, 200):
        (action,) = CONTROLLER.steer(*np.array([[speed, *map(round_state, (e, psi, w)), 0.0]]).T)
        w += STEP * action
        psi += STEP * w
        lateral_speed = speed * math.sin(psi)
        e -= STEP * lateral_speed
        cost += reward.yaw_acceleration_weight * abs(action) + reward.yaw_rate_weight * abs(w)
        cost += reward.deviation_weight * abs(e) / reward.average_deviation
        if (
            abs(e) <= completion.max_deviation
            and abs(lateral_speed) <= completion.max_lateral_speed
            and abs(w) <= completion.max_yaw_rate
        ):
            return cost, count
    raise AssertionError("not completed")


@pytest.mark.parametrize("speed", [12.0, 24.0])
@pytest.mark.parametrize("round_state", [float, np.float32])
def test_planned_anew_at_every_step_it_costs_what_the_optimum_costs(speed, round_state):
    """A plan made on the way is the rest of the first one, also from rounded observations."""
    cost, count = drive(speed, round_state)
    optimum = optimal_lane_change(PAPER, [speed], deviation=3.75)
    assert cost == pytest.approx(-optimum.total_return, rel=1e-4)
    assert abs(count - optimum.num_steps) <= 1


def test_where_no_plan_completes_the_actions_come_nearest():
    cost, actions = CONTROLLER.plan(1.0, 500.0, 0.0, 0.0, 0.0)
    assert math.isinf(cost)
    assert len(actions) == 200
    assert actions[0] == pytest.approx(0.5)
    assert np.abs(actions).max() <= 0.5 + 1e-6


def test_a_standing_vehicle_steers_as_at_walking_speed():
    cost, actions = CONTROLLER.plan(0.0, 3.75, 0.0, 0.0, 0.0)
    slow, same = CONTROLLER.plan(1.0, 3.75, 0.0, 0.0, 0.0)
    assert cost == slow
    assert np.array_equal(actions, same)
    # The yaw stays one at which a lane change makes sense.
    assert np.cumsum(0.01 * np.cumsum(actions)).max() < 0.6


def test_a_long_plan_is_found():
    cost, actions = CONTROLLER.plan(3.0, 3.75, 0.0, 0.0, 0.0)
    optimum = optimal_lane_change(PAPER, [3.0], deviation=3.75)
    assert len(actions) > 100
    assert cost == pytest.approx(-optimum.total_return, rel=2e-2)
