"""The linear program of one duration, compared with one in which the states are variables."""

import math
from dataclasses import replace

import numpy as np
import pytest
from optima import LANE_WIDTH, PASSING, PROFILES, SETTLED, primal_cost, replay_of, scenario_of

from marl_lanes.evaluation.linear_program import Program
from marl_lanes.evaluation.replay import DEVIATION, LATERAL_SPEED, YAW_RATE

SIZE = 80


def program_of(profile, completion, max_yaw_acceleration=0.5):
    """The program around steady driving on a straight road, a lane beside the target."""
    scenario = scenario_of(completion)
    speed = np.append(profile, np.full(SIZE - profile.size, profile[-1]))
    start = {"deviation": LANE_WIDTH, "yaw_rate": 0.0, "direction": 1}
    replay = replay_of(scenario, speed, start | {"position": 0.0, "lateral_position": 0.0})
    replay.follow(np.zeros(SIZE))
    free, response = replay.linearise(SIZE)
    bounds = np.full(3, np.inf)
    bounds[DEVIATION] = completion["max_deviation"]
    bounds[LATERAL_SPEED] = completion["max_lateral_speed"] or np.inf
    bounds[YAW_RATE] = completion["max_yaw_rate"] or np.inf
    return Program(free, response, bounds, max_yaw_acceleration, scenario.reward)


@pytest.mark.parametrize("bound", [0.5, 0.15])
@pytest.mark.parametrize("completion", [PASSING, SETTLED], ids=["passing", "settled"])
@pytest.mark.parametrize("profile", PROFILES.values(), ids=PROFILES.keys())
def test_the_cost_of_every_duration_is_that_of_the_other_program(profile, completion, bound):
    """Both have sin(psi) = psi: one at yaw 0, where it is linearised, the other everywhere."""
    program = program_of(profile, completion, bound)
    assert program.size == SIZE
    num_feasible = 0
    for num_steps in range(4, SIZE, 8):
        cost, actions = program.solve(num_steps)
        expected = primal_cost(profile, num_steps, completion, bound)
        if math.isinf(expected):
            assert math.isinf(cost)
            assert actions.shape == (0,)
            continue
        num_feasible += 1
        assert cost == pytest.approx(expected, rel=1e-5)
        assert actions.shape == (num_steps,)
        assert np.abs(actions).max() <= bound + 1e-7
        n = num_steps
        known = program.free[:, :n] + program.response[:, :n, :n] @ actions
        assert (np.abs(known[:, -1]) <= program.bounds + 1e-7).all()
        turning, deviation = np.abs(known[[YAW_RATE, DEVIATION]])
        terms = 2.0 * np.abs(actions) + 0.5 * turning + 0.05 * deviation / 1.875
        assert cost == pytest.approx(terms.sum())
    assert 3 < num_feasible < len(range(4, SIZE, 8))


def test_actions_complete_where_every_bound_holds_first():
    program = program_of(np.full(40, 20.0), SETTLED)
    cost, actions = program.solve(62)
    assert cost < math.inf
    found = program.first_completion(actions)
    known = program.free[:, :62] + program.response[:, :62, :62] @ actions
    is_there = (np.abs(known) <= program.bounds[:, np.newaxis] + 1e-7).all(axis=0)
    assert is_there.tolist().index(True) == found - 1
    assert program.first_completion(np.zeros(30)) == 30


def test_a_discount_weighs_each_step():
    """Later costs count less: the discounted optimum is cheaper by that measure, and slower."""
    program = program_of(np.full(40, 20.0), PASSING)
    discounted = replace(program, gamma=0.95)

    def cost_of(actions):
        n = actions.size
        known = program.free[:, :n] + program.response[:, :n, :n] @ actions
        turning, deviation = np.abs(known[[YAW_RATE, DEVIATION]])
        terms = 2.0 * np.abs(actions) + 0.5 * turning + 0.05 * deviation / 1.875
        return float(terms @ 0.95 ** np.arange(n))

    cost, actions = discounted.solve(60)
    assert cost == pytest.approx(cost_of(actions))
    assert cost < cost_of(program.solve(60)[1]) - 0.01
    assert np.abs(actions).max() < np.abs(program.solve(60)[1]).max()
