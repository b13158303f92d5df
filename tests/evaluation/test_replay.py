"""The replayed vehicle moves as in the simulator, and its derivatives are correct."""

import numpy as np
import pytest
from optima import LANE_WIDTH, ROADS, curved_start, replay_of, scenario_of

from marl_lanes.evaluation.measures import STEERING_COSTS
from marl_lanes.evaluation.optimum import optimal_lane_change
from marl_lanes.evaluation.replay import DEVIATION
from marl_lanes.traffic.machine.state import Outcome
from marl_lanes.traffic.roles.changer import CHANGER
from marl_lanes.traffic.simulator import Simulator


def alone_and_engaged(speed, desired, arcs, seed):
    """A simulator with one engaged changer and no vehicle near it."""
    fixed = {
        "departures": {
            "interval": [300.0, 300.0],
            "initial_speed": [speed, speed],
            "desired_speed": [desired, desired],
        },
        "command": {"probability": 1.0, "position": [100.0, 100.0]},
        "warmup": [0.0, 0.0],
    }
    simulator = Simulator(scenario_of(arcs=arcs, **fixed), seed=seed)
    simulator.reset()
    while not simulator.is_steering.any():
        simulator.step()
    return simulator


def drive(simulator, actions):
    """Sum of rewards, steps and outcome of the actions, then of zeros."""
    total, given = 0.0, np.zeros((1, simulator.num_slots, 1))
    slot = int(np.argmax(simulator.is_steering[0]))
    for step in range(400):
        given[:] = actions[step] if step < len(actions) else 0.0
        simulator.step(given)
        agent = simulator.agents[0, slot]
        total += sum(CHANGER.terms_of(agent)[f"reward_{x}"] for x in STEERING_COSTS)
        if agent["outcome"] != Outcome.UNFINISHED:
            return total, step + 1, Outcome(int(agent["outcome"]))
    raise AssertionError("the command does not end")


DRIVEN = [(name, 8.5, 8.5) for name in ROADS]
DRIVEN += [("straight", 28.0, 28.0), ("straight", 8.0, 25.0), ("wide", 25.0, 25.0)]
DRIVEN += [("right", 13.0, 13.0), ("step", 13.0, 13.0)]


@pytest.mark.parametrize("seed", [0, 1, 2])
@pytest.mark.parametrize(("road", "initial", "desired"), DRIVEN)
def test_the_actions_complete_in_the_simulator_at_the_cost_that_is_claimed(
    road, initial, desired, seed
):
    simulator = alone_and_engaged(initial, desired, ROADS[road], seed)
    agent = simulator.agents[0][simulator.is_steering[0]][0]
    car = simulator.vehicles[0, agent["vehicle"]]
    sign, centre = int(agent["direction"]), (agent["target_lane"] + 0.5) * LANE_WIDTH
    start = {
        "deviation": sign * float(centre - car["lateral_position"]),
        "yaw": sign * float(car["yaw"]),
        "yaw_rate": sign * float(car["yaw_rate"]),
        "direction": sign,
        "initial_speed": float(car["speed"]),
        "position": float(car["position"]),
        "lateral_position": float(car["lateral_position"]),
    }
    speed = np.full(120, initial)
    if initial != desired:
        state = simulator.snapshot()
        for k in range(120):
            simulator.step()
            speed[k] = car["speed"]
        assert speed[-1] > initial + 5.0
        simulator.restore(state)
    optimum = optimal_lane_change(simulator.scenario, speed, **start)
    total, num_steps, outcome = drive(simulator, optimum.yaw_acceleration)
    assert outcome == Outcome.COMPLETED
    assert num_steps == optimum.num_steps
    assert total == pytest.approx(optimum.total_return, rel=1e-9)


def replayed(arcs=(), direction=1, num_steps=70):
    """A replay at rising speed through the roads' curves."""
    scenario = scenario_of(arcs=arcs)
    start = curved_start(scenario, speed=9.0, position=115.0, direction=direction)
    return replay_of(scenario, np.linspace(9.0, 15.0, num_steps), start)


@pytest.mark.parametrize("direction", [1, -1])
@pytest.mark.parametrize("arcs", ROADS.values(), ids=ROADS.keys())
def test_the_derivatives_are_those_of_the_motion(arcs, direction):
    """Small changes of every action together, against the motion with them."""
    replay, rng = replayed(arcs, direction), np.random.default_rng(0)
    actions = rng.uniform(-0.2, 0.2, 70)
    known = replay.follow(actions)
    free, response = replay.linearise(60)
    assert free.shape == (3, 60)
    assert response.shape == (3, 60, 60)
    np.testing.assert_allclose(free + response @ actions[:60], known[:, :60], atol=1e-9)
    # No action has an effect on what came before it.
    assert not np.triu(response, 1).any()
    changes = 1e-4 * rng.standard_normal(70)
    found = replay.follow(actions + changes)[:, :60] - known[:, :60]
    np.testing.assert_allclose(response @ changes[:60], found, atol=1e-4 * np.abs(found).max())
    assert np.abs(found[DEVIATION]).max() > 1e-3


@pytest.mark.parametrize("direction", [1, -1])
@pytest.mark.parametrize("arcs", ROADS.values(), ids=ROADS.keys())
def test_steering_ends_in_the_target_lane(arcs, direction):
    replay = replayed(arcs, direction, num_steps=220)
    replay.follow(np.zeros(5))
    replay.steer(5, 220)
    known = replay.follow(replay._actions)
    assert known[DEVIATION, 0] == pytest.approx(3.75, abs=0.02)
    assert np.abs(known[DEVIATION, 150:]).max() < 0.3
    assert np.abs(replay._actions).max() <= 0.5


@pytest.mark.parametrize("direction", [1, -1])
def test_the_path_is_the_vehicle_before_and_after_each_step(direction):
    replay, rng = replayed(ROADS["straight"], direction), np.random.default_rng(0)
    actions = rng.uniform(-0.2, 0.2, 50)
    known = replay.follow(actions)
    path = replay.path(50)
    assert path.shape == (51,)
    moved = direction * np.diff(path["lateral_position"])
    np.testing.assert_allclose(-np.diff(known[DEVIATION]), moved[1:], atol=1e-12)
    np.testing.assert_allclose(direction * path["yaw_acceleration"][1:], actions, atol=1e-12)
    # A copy: another path does not change it.
    before = path["yaw"].copy()
    replay.follow(-actions)
    np.testing.assert_array_equal(path["yaw"], before)
