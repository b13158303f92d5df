"""Collisions: which rectangles overlap, what is recorded, which vehicles leave."""

import math

import numpy as np
import pytest
from reference.geometry import hull, overlap_area
from reference.road import Road
from staging import MIXED, TRUCK, command, pose_of, simulator_of, stage

from marl_lanes.traffic.flow.collisions import is_crossing, is_overlapping
from marl_lanes.traffic.machine.state import NUM_COLLISION_RECORDS, CollisionKind, Outcome
from marl_lanes.traffic.roles.changer import CHANGER


def newest(simulator):
    index = (int(simulator.roads["num_collisions"][0]) - 1) % NUM_COLLISION_RECORDS
    return simulator.state.collisions[0, index]


def set_pose(row, position, lateral, yaw):
    row["position"], row["lateral_position"], row["yaw"] = position, lateral, yaw


def corners(simulator, row):
    return Road(simulator.scenario).corners(pose_of(simulator, row))


def test_overlap_agrees_with_polygon_clipping():
    simulator = simulator_of()
    profiles = simulator.parameters.profiles
    rear, front = simulator.vehicles[0, 0], simulator.vehicles[0, 1]
    generator = np.random.default_rng(0)
    counts = [0, 0]
    for trial in range(4000):
        yaws = generator.uniform(-1.5, 1.5, 2) if trial % 4 else np.zeros(2)
        rear["profile"], front["profile"] = generator.choice([0, TRUCK], 2)
        reach = 6.0 if rear["profile"] == front["profile"] == 0 else 13.0
        set_pose(rear, 0.0, 5.0, yaws[0])
        set_pose(front, generator.uniform(0.0, reach), 5.0 + generator.uniform(-5.0, 5.0), yaws[1])
        area = overlap_area(corners(simulator, rear), corners(simulator, front))
        is_hit = is_overlapping(rear, front, profiles)
        assert is_hit == (area > 0.0)
        assert is_hit == is_overlapping(front, rear, profiles)
        counts[is_hit] += 1
    assert min(counts) > 800


def test_crossing_agrees_with_clipping_the_hull_of_the_way():
    simulator = simulator_of()
    profiles = simulator.parameters.profiles
    rear, front = simulator.vehicles[0, 0], simulator.vehicles[0, 1]
    generator = np.random.default_rng(1)
    counts = [0, 0]
    for trial in range(3000):
        yaws = generator.uniform(-1.5, 1.5, 2) if trial % 4 else np.zeros(2)
        rear["profile"], front["profile"] = generator.choice([0, TRUCK], 2)
        set_pose(rear, 0.0, 5.0, yaws[0])
        set_pose(front, generator.uniform(-9.0, 9.0), generator.uniform(-4.0, 14.0), yaws[1])
        along, across = generator.uniform(-15.0, 15.0), generator.uniform(-9.0, 9.0)
        body = corners(simulator, front)
        way = hull(body + [(x - along, y - across) for x, y in body])
        is_hit = bool(overlap_area(way, corners(simulator, rear)) > 0.0)
        assert is_crossing(rear, front, along, across, profiles) == is_hit
        assert is_crossing(front, rear, -along, -across, profiles) == is_hit
        counts[is_hit] += 1
    assert min(counts) > 500


FAST = {"time_step": 0.5, "lane_keeping": {"pole": 1.0}}
"""Steps in which a vehicle moves by several lengths."""


@pytest.mark.parametrize(
    ("position", "ahead", "lane", "is_hit"),
    [
        (100.0, 10.0, 1, True),
        (100.0, 10.0, 2, False),
        # Too far ahead to be reached: the fast one ends 5 m behind it.
        (100.0, 33.0, 1, False),
        # Just entered, and over the road's end in the same step.
        (0.0, 10.0, 1, True),
        (985.0, 10.0, 1, True),
    ],
)
def test_a_vehicle_that_drives_through_another_in_a_step_collides_with_it(
    position, ahead, lane, is_hit
):
    simulator = simulator_of(**FAST)
    stage(
        simulator,
        {"lane": 1, "position": position, "speed": 60.0, "id": 71},
        {"lane": lane, "position": position + ahead, "speed": 0.0, "id": 72},
    )
    simulator.step()
    assert simulator.roads["num_collided"][0] == (2 if is_hit else 0)
    if is_hit:
        record = newest(simulator)
        assert (record["rear_id"], record["front_id"]) == (71, 72)
        assert record["kind"] == CollisionKind.REAR_END
        # The fast one brakes with 8 m/s^2, the other one accelerates with 2 m/s^2 or less.
        assert record["closing_speed"] == pytest.approx(56.0 - 1.0, abs=0.1)
        assert record["position"] == pytest.approx(position + 0.5 * 56.0)


@pytest.mark.parametrize(("offset", "is_hit"), [(0.0, True), (-3.0, True), (9.0, False)])
def test_a_vehicle_that_crosses_a_neighbor_sideways_in_a_step_collides_with_it(offset, is_hit):
    simulator = simulator_of(**FAST, road={"num_lanes": 5})
    turned = {"yaw": 0.9, "yaw_rate": 0.0, "speed": 30.0}
    stage(
        simulator,
        {"lane": 0, "position": 100.0, "id": 71, **turned, "lateral_position": 3.0},
        {"lane": 1, "position": 100.0 - offset, "speed": 20.0, "id": 72, "lateral_position": 6.8},
    )
    simulator.step()
    crossing, other = simulator.vehicles[0, :2]
    assert crossing["lateral_position"] - other["lateral_position"] > 3.2
    profiles = simulator.parameters.profiles
    assert not is_overlapping(crossing, other, profiles)
    assert simulator.roads["num_collided"][0] == (2 if is_hit else 0)
    if is_hit:
        record = newest(simulator)
        assert record["kind"] == CollisionKind.SIDE
        assert {record["rear_id"], record["front_id"]} == {71, 72}


def test_touching_is_not_overlapping():
    simulator = simulator_of()
    profiles = simulator.parameters.profiles
    rear, front = simulator.vehicles[0, 0], simulator.vehicles[0, 1]
    set_pose(rear, 0.0, 0.0, 0.0)
    for position, lateral, expected in (
        (4.8, 0.0, False),
        (4.799, 0.0, True),
        (0.0, 1.8, False),
        (0.0, 1.799, True),
    ):
        set_pose(front, position, lateral, 0.0)
        assert is_overlapping(rear, front, profiles) == expected


def test_a_rear_end_collision_is_recorded_with_vehicles_and_kind():
    simulator = simulator_of()
    stage(
        simulator,
        {"lane": 1, "position": 105.5, "speed": 1.0, "id": 71},
        {"lane": 1, "position": 100.0, "speed": 30.0, "id": 72},
        {"lane": 1, "position": 60.0, "speed": 5.0, "id": 73},
        {"lane": 2, "position": 101.0, "speed": 20.0, "id": 74},
    )
    agent = command(simulator, 1, 1)
    simulator.roads["num_commands"] = 8
    simulator.agents[0, agent]["command"] = 7
    simulator.step()
    record = newest(simulator)
    assert simulator.roads["num_collisions"][0] == 1
    assert (record["rear_id"], record["front_id"]) == (72, 71)
    assert (record["rear_command"], record["front_command"]) == (7, -1)
    assert record["kind"] == CollisionKind.REAR_END
    assert record["step"] == 1
    assert record["position"] == pytest.approx(100.0 + 0.1 * (30.0 - 0.8))
    # The rear vehicle brakes at its limit, the front one accelerates with 2 m/s^2.
    assert record["closing_speed"] == pytest.approx(29.2 - 1.2, abs=0.01)
    remaining = simulator.vehicles[0]["id"][simulator.vehicles[0]["id"] >= 0]
    assert sorted(remaining.tolist()) == [73, 74]
    assert simulator.roads["num_collided"][0] == 2
    assert simulator.agents[0, agent]["outcome"] == Outcome.COLLISION
    assert CHANGER.terms_of(simulator.agents[0, agent])["reward_failure"] == -10.0


@pytest.mark.parametrize("offset", [-2.0, 1.0])
def test_a_contact_from_the_side_is_a_side_collision(offset):
    simulator = simulator_of()
    stage(
        simulator,
        {"lane": 2, "position": 100.0, "speed": 20.0},
        {"lane": 1, "position": 100.0 + offset, "speed": 20.0, "lateral_position": 7.5},
    )
    simulator.vehicles[0, 1]["yaw"] = 0.1
    command(simulator, 1, 1)
    simulator.step()
    assert simulator.roads["num_collisions"][0] == 1
    assert newest(simulator)["kind"] == CollisionKind.SIDE
    is_ahead = offset > 0.0
    expected = (-1, 0) if is_ahead else (0, -1)
    assert (newest(simulator)["rear_command"], newest(simulator)["front_command"]) == expected


def test_vehicles_side_by_side_in_their_lanes_do_not_collide():
    simulator = simulator_of()
    stage(simulator, *({"lane": lane, "position": 100.0} for lane in range(3)))
    for _ in range(50):
        simulator.step()
    assert simulator.roads["num_collisions"][0] == 0
    assert simulator.roads["num_vehicles"][0] == 3


def test_a_pile_up_counts_every_vehicle_once_and_every_pair():
    simulator = simulator_of()
    stage(simulator, *({"lane": 1, "position": 100.0 + 3.0 * n, "speed": 0.1} for n in range(4)))
    simulator.step()
    assert simulator.roads["num_collided"][0] == 4
    assert simulator.roads["num_collisions"][0] == 3
    assert simulator.roads["num_vehicles"][0] == 0


def test_the_newest_records_are_kept_and_the_counter_counts_all():
    simulator = simulator_of()
    total = NUM_COLLISION_RECORDS + 3
    for number in range(total):
        stage(
            simulator,
            {"lane": 1, "position": 100.0, "id": 2 * number},
            {"lane": 1, "position": 99.0, "id": 2 * number + 1},
        )
        simulator.step()
    assert simulator.roads["num_collisions"][0] == total
    fronts = sorted(simulator.state.collisions[0]["front_id"].tolist())
    assert fronts == [2 * number for number in range(3, total)]
    simulator.reset()
    assert (simulator.state.collisions["rear_id"] == -1).all()


def test_a_vehicle_that_collides_off_the_road_counts_only_as_collided():
    simulator = simulator_of()
    stage(
        simulator,
        {"lane": 0, "position": 100.0, "lateral_position": 1.0, "yaw": -0.2, "speed": 15.0},
        {"lane": 0, "position": 96.0, "lateral_position": 1.0, "speed": 15.0},
    )
    simulator.step()
    roads = simulator.roads[0]
    assert roads["num_collided"] == 2
    assert roads["num_left"] == 0
    assert roads["num_off_road"] == 0


def test_a_turned_rectangle_reaches_as_far_as_its_corners():
    simulator = simulator_of()
    stage(simulator, {"lane": 1, "position": 100.0, "yaw": 0.5, "speed": 0.0})
    simulator.step()
    extent = 2.4 * math.sin(0.5) + 0.9 * math.cos(0.5)
    assert extent > 1.875
    car = simulator.vehicles[0, 0]
    assert (car["lane_low"], car["lane_high"]) == (0, 2)


@pytest.mark.parametrize(
    ("behind", "ahead", "length", "width"),
    [(0, TRUCK, 10.65, 2.175), (TRUCK, 0, 10.65, 2.175), (TRUCK, TRUCK, 16.5, 2.55)],
)
def test_bodies_of_two_sizes_touch_at_half_of_each(behind, ahead, length, width):
    simulator = simulator_of()
    rear, front = simulator.vehicles[0, 0], simulator.vehicles[0, 1]
    rear["profile"], front["profile"] = behind, ahead
    set_pose(rear, 0.0, 0.0, 0.0)
    for position, lateral, expected in (
        (length + 1e-6, 0.0, False),
        (length - 1e-6, 0.0, True),
        (0.0, width + 1e-6, False),
        (0.0, width - 1e-6, True),
    ):
        set_pose(front, position, lateral, 0.0)
        assert is_overlapping(rear, front, simulator.parameters.profiles) == expected


@pytest.mark.parametrize(("distance", "num_hit"), [(10.7, 0), (10.6, 2)])
@pytest.mark.parametrize("ahead", [0, TRUCK])
def test_a_car_and_a_truck_collide_where_their_bumpers_meet(ahead, distance, num_hit):
    """Their centres are 2.4 m + 8.25 m apart then; both stand."""
    simulator = simulator_of(**MIXED)
    still = {"lane": 1, "speed": 0.0, "desired_speed": 1e-3}
    places = {TRUCK - ahead: 100.0, ahead: 100.0 + distance}
    stage(simulator, *({**still, "position": at, "profile": who} for who, at in places.items()))
    simulator.step()
    assert simulator.roads["num_collided"][0] == num_hit


def test_a_car_beside_a_trucks_tail_collides_with_its_side():
    """Its centre is 9 m behind that of the truck: bodies of its own length would not be beside."""
    simulator = simulator_of(**MIXED)
    stage(
        simulator,
        {"lane": 2, "position": 109.0, "profile": TRUCK},
        {"lane": 1, "position": 100.0, "lateral_position": 7.1, "yaw": 0.1},
    )
    simulator.step()
    assert simulator.roads["num_collided"][0] == 2
    assert newest(simulator)["kind"] == CollisionKind.SIDE


def test_a_truck_occupies_more_lanes_than_a_car():
    """Its half width is 1.275 m, and 0.9 m that of a car; turned, its corners reach further."""
    simulator = simulator_of(**MIXED)
    near = {"lane": 1, "lateral_position": 6.4, "speed": 0.0}
    turned = {"lane": 1, "yaw": 0.2, "speed": 0.0}
    places = ((near, 100.0), (turned, 200.0))
    cars = [{**pose, "position": at, "profile": 0} for pose, at in places]
    trucks = [{**pose, "position": at + 50.0, "profile": TRUCK} for pose, at in places]
    stage(simulator, *cars, *trucks)
    simulator.step()
    found = simulator.vehicles[0, :4]
    # 8.25 sin(0.2) + 1.275 cos(0.2) = 2.89 m, and 1.36 m for a car; a lane's edge is 1.875 m away.
    assert found["lane_low"].tolist() == [1, 1, 1, 0]
    assert found["lane_high"].tolist() == [1, 1, 2, 2]


def test_a_truck_leaves_the_road_with_its_own_corner():
    simulator = simulator_of(**MIXED)
    pose = {"lane": 0, "lateral_position": 1.8, "yaw": 0.1, "speed": 5.0}
    stage(
        simulator,
        {**pose, "position": 100.0, "profile": 0},
        {**pose, "position": 200.0, "profile": TRUCK},
    )
    simulator.step()
    # 8.25 sin(0.1) + 1.275 cos(0.1) = 2.09 m from the centre, and 1.14 m for a car.
    assert simulator.roads["num_off_road"][0] == 1
    assert simulator.vehicles[0, 0]["id"] >= 0
