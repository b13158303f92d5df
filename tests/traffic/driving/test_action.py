"""An action as acceleration: its limits, and the guard."""

import numpy as np
import pytest
from external_followers import advance, brake_checker, driven, mixed
from staging import command, simulator_of, stage

from marl_lanes import Simulator
from marl_lanes.traffic.machine.state import Phase
from marl_lanes.traffic.roles.external import FOLLOWER_COLUMNS

KINEMATIC = {"rule": "kinematic", "minimum_gap": 2.0, "time_gap": 0.4, "max_braking": 4.0}


def test_an_unguarded_policys_acceleration_is_the_vehicles():
    simulator = driven(brake_checker, guarded=False)
    found, wanted = [], []
    for _ in range(600):
        (envs, slots), seen = advance(simulator)
        found += simulator.vehicles[envs, slots]["acceleration"].tolist()
        wanted += brake_checker(seen).tolist()
    assert len(found) > 300
    assert found == wanted
    assert set(found) == {-3.0, 1.5}


def test_the_guard_only_lowers_a_policys_acceleration():
    simulator = driven(brake_checker)
    found, wanted = [], []
    for _ in range(600):
        (envs, slots), seen = advance(simulator)
        found += simulator.vehicles[envs, slots]["acceleration"].tolist()
        wanted += brake_checker(seen).tolist()
    found, wanted = np.asarray(found), np.asarray(wanted)
    assert (found <= wanted).all()
    assert (found >= -8.0).all()
    assert 0.0 < (found < wanted).mean() < 0.5
    assert (found == -3.0).any()


def test_no_follower_accelerates_beyond_the_speed_limit():
    limit = {"mix": {"mine": 1.0}, "external": {"is_guarded": False, "max_speed": 12.0}}
    policies = {"mine": lambda observations: np.full(len(observations), 3.0)}
    simulator = Simulator(
        "dense", 4, overrides={"followers": limit}, follower_policies=policies, seed=1
    )
    simulator.reset()
    at_limit = 0
    for _ in range(400):
        (envs, slots), seen = advance(simulator)
        cars, before = simulator.vehicles[envs, slots], seen[:, FOLLOWER_COLUMNS["speed"]]
        slow = before < 12.0
        assert (cars["speed"][slow] <= 12.0 + 1e-9).all()
        assert (cars["acceleration"][~slow] <= 1e-6).all()
        at_limit += len(before)
    assert at_limit > 300


def count_collisions(guarded):
    policy = {"mine": lambda observations: np.full(len(observations), 3.0)}
    followers = mixed("mine", external={"is_guarded": guarded})
    simulator = Simulator(
        "dense",
        100,
        overrides={**followers, "num_agents": 20, "gap": {"rule": "kinematic"}},
        follower_policies=policy,
        seed=0,
    )
    simulator.reset()
    num_paired = 0
    while not simulator.roads["is_done"].all():
        rows, _ = advance(simulator)
        num_paired += len(rows[0])
    return int(simulator.roads["num_collisions"].sum()), num_paired


@pytest.mark.slow
def test_only_with_the_guard_a_reckless_policy_does_not_collide():
    """2,000 maneuvers with followers that always want 3 m/s^2, with and without the guard."""
    collisions, num_paired = count_collisions(guarded=True)
    assert num_paired > 20_000
    assert collisions == 0
    collisions, _ = count_collisions(guarded=False)
    assert collisions > 100


def acceleration_of(action, *cars, phase=Phase.WAITING):
    """What the first car, a changer from lane 1 to lane 2, does with a longitudinal action."""
    simulator = simulator_of(action={"longitudinal": {}}, gap=KINEMATIC)
    stage(simulator, *cars)
    command(simulator, 0, 1, phase)
    simulator.step(np.full((1, simulator.num_slots, 2), [0.0, action]))
    return simulator.vehicles[0, 0]["acceleration"]


@pytest.mark.parametrize(
    ("speed", "action", "expected"),
    [
        (20.0, 1.25, 1.25),
        (20.0, 9.0, 2.0),
        (20.0, -9.0, -3.0),
        # To 40 m/s in a step, and no faster.
        (39.95, 2.0, 0.5),
        (41.0, 2.0, 0.0),
        (41.0, -1.0, -1.0),
    ],
)
def test_a_second_action_keeps_to_its_bounds_and_to_the_largest_speed(speed, action, expected):
    assert acceleration_of(action, {"lane": 1, "position": 200.0, "speed": speed}) == pytest.approx(
        expected
    )


@pytest.mark.parametrize(
    ("phase", "expected"), [(Phase.WAITING, 1.9), (Phase.ENGAGED, 2.0 * (1.0 - (10.0 / 12.0) ** 2))]
)
def test_the_guard_heeds_the_target_lane_of_an_engaged_changer(phase, expected):
    """At 20 m/s behind one as fast: s* = d_min + v tau = 10 m."""
    own = {"lane": 1, "position": 200.0}
    assert acceleration_of(1.9, own, {"lane": 2, "position": 216.8}, phase=phase) == pytest.approx(
        expected
    )
    # In the own lane it counts in either phase.
    ahead = {"lane": 1, "position": 216.8}
    assert acceleration_of(1.9, own, ahead, phase=phase) == pytest.approx(
        2.0 * (1.0 - (10.0 / 12.0) ** 2)
    )
