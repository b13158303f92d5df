"""The surrogate measures of safety against values worked out by hand."""

import math

import numpy as np
import pytest
from traces import trace

from marl_lanes import load_scenario
from marl_lanes.evaluation.safety import attempts, entry_row, measure_safety, rss_distance
from marl_lanes.traffic.machine.state import Phase

PAPER = load_scenario("paper")


def measured(count=3, **columns):
    return measure_safety(trace(count, **columns), PAPER)


CLOSING = {"leader_gap": 30.0, "leader_speed": 15.0}


@pytest.mark.parametrize(
    ("columns", "expected"),
    [
        ({}, math.inf),
        (CLOSING, 6.0),
        ({"leader_gap": 30.0, "leader_speed": 25.0}, math.inf),
        ({"leader_gap": [30.0, 8.0, 50.0], "leader_speed": [15.0, 18.0, 10.0]}, 4.0),
        ({"follower_gap": 30.0, "follower_speed": 25.0}, 6.0),
        ({"follower_gap": 30.0, "follower_speed": 20.0}, math.inf),
        ({"follower_gap": -2.0, "follower_speed": 25.0}, math.inf),
        ({"leader_gap": [0.0, -1.0, 10.0], "leader_speed": 15.0}, 2.0),
        ({**CLOSING, "follower_gap": 10.0, "follower_speed": 25.0}, 2.0),
        # Neighbors in the target lane count while engaged, not while aborting.
        ({**CLOSING, "phase": Phase.ABORTING}, math.inf),
        ({**CLOSING, "phase": Phase.ABORTING, "is_over_marking": True}, 6.0),
        # Neighbors in the origin lane count as long as the body is in it.
        ({"origin_leader_gap": 20.0, "origin_leader_speed": 15.0}, math.inf),
        ({"origin_leader_gap": 20.0, "origin_leader_speed": 15.0, "is_in_origin": True}, 4.0),
        ({"origin_follower_gap": 5.0, "origin_follower_speed": 25.0, "is_in_origin": True}, 1.0),
    ],
)
def test_time_to_collision(columns, expected):
    assert measured(**columns).min_time_to_collision == pytest.approx(expected)


def test_time_to_collision_by_neighbor():
    found = measured(
        is_in_origin=True,
        leader_gap=30.0,
        leader_speed=15.0,
        follower_gap=10.0,
        follower_speed=25.0,
        origin_leader_gap=40.0,
        origin_leader_speed=15.0,
        origin_follower_gap=15.0,
        origin_follower_speed=25.0,
    )
    assert found.min_time_to_collision_target_leader == 6.0
    assert found.min_time_to_collision_target_follower == 2.0
    assert found.min_time_to_collision_origin_leader == 8.0
    assert found.min_time_to_collision_origin_follower == 3.0


def test_exposed_and_integrated_time():
    """TTC 3, 1, 0.5 and 1.5 s: below 1.5 s in two rows of 0.1 s, by 0.5 and 1 s."""
    gaps = {"follower_gap": [15.0, 5.0, 2.5, 7.5], "follower_speed": 25.0}
    found = measured(4, **gaps)
    assert found.time_exposed == pytest.approx(0.2)
    assert found.time_integrated == pytest.approx(0.15)
    # In every row the most urgent neighbor counts, once.
    found = measured(4, **gaps, leader_gap=[2.5, 25.0, 25.0, 25.0], leader_speed=15.0)
    assert found.time_exposed == pytest.approx(0.3)
    assert found.time_integrated == pytest.approx(0.25)
    assert measured(4).time_exposed == measured(4).time_integrated == 0.0
    assert math.isnan(measured(0).time_exposed)


def test_drac():
    # 5^2/(2 * 10) behind, 10^2/(2 * 25) ahead, in one row each.
    found = measured(
        follower_gap=[10.0, np.inf, np.inf],
        follower_speed=25.0,
        leader_gap=[50.0, 25.0, 50.0],
        leader_speed=[19.0, 10.0, 21.0],
    )
    assert found.drac == pytest.approx(2.0)
    assert measured(follower_gap=10.0, follower_speed=25.0).drac == pytest.approx(1.25)
    assert measured(follower_gap=10.0, follower_speed=15.0).drac == 0.0
    assert math.isnan(measured(0).drac)


def test_imposed_braking_is_the_largest():
    found = measured(imposed_on_follower=[np.nan, 0.5, 0.25], imposed_on_changer=[1.0, 0.0, 3.0])
    assert (found.imposed_on_follower, found.imposed_on_changer) == (0.5, 3.0)
    assert math.isnan(measured(imposed_on_follower=np.nan).imposed_on_follower)


def test_the_entry_is_where_an_engaged_body_is_first_in_the_lane():
    over = [False, True, False, True]
    phase = [Phase.ENGAGED, Phase.ABORTING, Phase.ENGAGED, Phase.ENGAGED]
    assert entry_row(trace(4, is_over_marking=over)) == 1
    assert entry_row(trace(4, is_over_marking=over, phase=phase)) == 3
    assert entry_row(trace(4)) is None


def test_attempts_are_told_apart_by_the_pause_between_them():
    rows = trace(6, step=[3, 4, 5, 9, 10, 12])
    assert [part["step"].tolist() for part in attempts(rows)] == [[3, 4, 5], [9, 10], [12]]


def test_headways_at_the_entry():
    """Front to front: the gap and a vehicle's length."""
    found = measured(
        is_over_marking=[False, True, True],
        follower_gap=[1.0, 25.2, 1.0],
        follower_speed=[1.0, 15.0, 1.0],
        leader_gap=[1.0, 35.2, 1.0],
        leader_speed=30.0,
    )
    assert found.time_headway_follower == pytest.approx(2.0)
    assert found.time_headway_leader == pytest.approx(2.0)
    found = measured(is_over_marking=True, leader_gap=[-1.0, 5.0, 5.0])
    assert found.time_headway_leader == pytest.approx(3.8 / 20.0)
    assert math.isnan(found.time_headway_follower)
    assert math.isnan(measured(leader_gap=10.0).time_headway_leader)
    standing = measured(is_over_marking=True, follower_gap=10.0, follower_speed=0.0)
    assert math.isnan(standing.time_headway_follower)


def moving(count, entry, *, follower=None, leader=None):
    """The changer at 20 m/s, over the marking from row ``entry`` on; others at constant speeds.

    Args:
        follower: gap at the entry and speed; ``leader`` alike.
    """
    time = 0.1 * (np.arange(count) - entry)
    columns = {"position": 200.0 + 20.0 * time, "is_over_marking": time >= 0.0}
    for side, given, sign in (("follower", follower, 1.0), ("leader", leader, -1.0)):
        if given is not None:
            gap, speed = given
            columns[f"{side}_gap"] = gap + sign * (20.0 - speed) * time
            columns[f"{side}_speed"], columns[f"{side}_id"] = speed, 4
    return columns


@pytest.mark.parametrize("count", [40, 12])
def test_post_encroachment_time(count):
    """30 m behind at 24 m/s: 1.25 s later; 18 m ahead at 15 m/s: 1.2 s before.

    Whether the rows reach that far or not.
    """
    for entry in (2, count - 2):
        columns = moving(count, entry, follower=(30.0, 24.0), leader=(18.0, 15.0))
        found = measured(count, **columns)
        assert found.post_encroachment_time_follower == pytest.approx(1.25)
        assert found.post_encroachment_time_leader == pytest.approx(1.2)


def test_post_encroachment_time_is_measured_where_the_rows_reach():
    """A follower that brakes arrives later than at its speed at the entry."""
    columns = moving(40, 0, follower=(20.0, 20.0))
    time = 0.1 * np.arange(40)
    columns["follower_gap"] = 20.0 + 0.5 * 4.0 * time**2
    columns["follower_speed"] = 20.0 - 4.0 * time
    # 20 = 20 t - 2 t^2
    found = measured(40, **columns).post_encroachment_time_follower
    assert found == pytest.approx(5.0 - math.sqrt(15.0), abs=0.002)


def test_post_encroachment_is_of_one_vehicle():
    columns = moving(40, 0, follower=(40.0, 20.0))
    columns["follower_id"] = [4] * 5 + [6] * 35
    columns["follower_gap"] = [40.0] * 5 + [1.0] * 35
    found = measured(40, **columns)
    # Another vehicle is now near; the follower at the entry is extrapolated at its speed.
    assert found.post_encroachment_time_follower == pytest.approx(2.0)
    assert math.isnan(measured(40, **moving(40, 0)).post_encroachment_time_follower)
    assert math.isnan(measured(40, **moving(40, 40)).post_encroachment_time_leader)
    beside = measured(40, **moving(40, 3, follower=(-1.0, 20.0)))
    assert beside.post_encroachment_time_follower == 0.0


def test_the_rss_distance():
    """20 m/s behind 20 m/s: 20 + 1.75 + 23.5^2/8 - 400/16."""
    assert rss_distance(20.0, 20.0) == pytest.approx(20.0 + 1.75 + 69.03125 - 25.0)
    assert rss_distance(0.0, 30.0) == 0.0
    assert rss_distance(np.array([10.0, 0.0]), 0.0) == pytest.approx([34.53125, 3.28125])


def test_rss_violations():
    """65.78 m at 20 m/s; only in the lane, for each neighbor separately."""
    near, far = 65.7, 65.9
    found = measured(
        4,
        is_over_marking=[False, True, True, True],
        leader_gap=[near, far, near, near],
        leader_speed=20.0,
        follower_gap=[near, far, far, near],
        follower_speed=20.0,
    )
    assert (found.is_rss_violated_leader, found.is_rss_violated_follower) == (1.0, 1.0)
    assert found.rss_violation_time == pytest.approx(0.2)
    found = measured(2, is_over_marking=True, follower_gap=far, follower_speed=20.0)
    assert found.is_rss_violated_follower == found.rss_violation_time == 0.0
    assert math.isnan(found.is_rss_violated_leader)
    assert math.isnan(measured(2, leader_gap=near, leader_speed=20.0).is_rss_violated_leader)


def test_from_marking_to_marking():
    over = [False, True, True, True, True, True]
    assert measured(
        6, is_over_marking=over, is_in_origin=[True] * 4 + [False] * 2
    ).marking_duration == pytest.approx(0.3)
    assert math.isnan(measured(6, is_over_marking=over, is_in_origin=True).marking_duration)
    assert math.isnan(measured(6).marking_duration)


def test_braking_before_and_after_the_marking():
    found = measured(
        4,
        is_over_marking=[False, False, True, True],
        acceleration=[-1.0, -0.5, -3.0, -0.5],
        follower_acceleration=[0.5, np.nan, np.nan, -4.0],
    )
    assert found.changer_braking_before_marking == 3.0
    assert found.changer_braking_after_marking == 0.5
    assert found.follower_braking_before_marking == 0.0
    assert found.follower_braking_after_marking == 4.0
    found = measured(2, acceleration=[-1.0, -3.0])
    assert found.changer_braking_before_marking == 3.0
    assert math.isnan(found.changer_braking_after_marking)


@pytest.mark.parametrize(
    ("speed", "follower", "critical"),
    [
        # UN R79's example: 130 km/h behind 100 km/h.
        (100.0 / 3.6, 130.0 / 3.6, 42.7),
        (20.0, 20.0, 20.0),
        (20.0, 10.0, 20.0),
        (20.0, 26.0, 20.0 + 2.4 + 6.0),
    ],
)
def test_the_critical_distance(speed, follower, critical):
    def is_violated(gap, **changes):
        columns = {"is_over_marking": True, "speed": speed, "follower_speed": follower}
        return measured(**(columns | {"follower_gap": gap} | changes)).is_s_critical_violated

    assert is_violated(critical - 0.05) == 1.0
    assert is_violated(critical + 0.05) == 0.0
    assert math.isnan(is_violated(critical - 0.05, is_over_marking=False))
    assert math.isnan(is_violated(np.inf))
    # Only the first row at the marking counts.
    over = [False, True, True]
    assert is_violated([1.0, critical + 0.05, 1.0], is_over_marking=over) == 0.0
    assert is_violated([99.0, critical - 0.05, 99.0], is_over_marking=over) == 1.0


def test_sizes_are_those_of_the_vehicles():
    """A truck of 16.5 m that changes ahead of a car, and behind a van of 6 m."""
    sizes = {"length": 16.5, "leader_length": 6.0}
    found = measured(
        is_over_marking=True,
        follower_gap=13.5,
        follower_speed=15.0,
        leader_gap=34.0,
        leader_speed=20.0,
        **sizes,
    )
    # Front to front: the gap, and the length of the vehicle ahead.
    assert found.time_headway_follower == pytest.approx((13.5 + 16.5) / 15.0)
    assert found.time_headway_leader == pytest.approx((34.0 + 6.0) / 20.0)
    columns = moving(40, 2, follower=(30.0, 24.0), leader=(18.0, 15.0))
    found = measured(40, **columns, **sizes)
    # From bumper to bumper, whatever the lengths.
    assert found.post_encroachment_time_follower == pytest.approx(1.25)
    assert found.post_encroachment_time_leader == pytest.approx(1.2)
