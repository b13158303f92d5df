import numpy as np
import pytest

from marl_lanes.evaluation.policies import make_lane_keeping_policy, make_tuned_cascade_policy
from marl_lanes.evaluation.recording import record_road
from marl_lanes.rendering.excerpt import (
    FOLLOW_UP_TIME,
    LEAD_TIME,
    find_crossing,
    find_excerpt,
)
from marl_lanes.scenario import load_scenario
from marl_lanes.traffic.machine.state import NONE, Outcome, Phase
from marl_lanes.trajectory.columns import new_rows
from marl_lanes.trajectory.metadata import TrajectoryError

DT = 0.1


def road(*lives, last_step=400):
    """Rows of vehicles, each with the step of its command, and of every change of its phase.

    A life is (vehicle, command, {step: phase}, last step, outcome).
    """
    blocks = []
    for vehicle, command, phases, end, outcome in lives:
        rows = new_rows(last_step + 1)
        rows["step"] = np.arange(last_step + 1)
        rows["time"] = rows["step"] * DT
        rows["vehicle"] = vehicle
        begin = min(phases)
        for step, phase in sorted(phases.items()):
            rows["phase"][step:end] = phase
        rows["command"][begin : end + 1] = command
        rows["outcome"][end] = outcome
        rows["origin_lane"][begin : end + 1], rows["target_lane"][begin : end + 1] = 1, 2
        blocks.append(rows)
    return np.concatenate(blocks)


# It engages, turns back, engages again and completes after the next one.
PATIENT = (5, 0, {20: 1, 40: 2, 50: 3, 80: 1, 200: 2}, 260, Outcome.COMPLETED)
QUICK = (8, 1, {60: 1, 90: 2}, 150, Outcome.COMPLETED)
MISSED = (9, 2, {70: 1}, 200, Outcome.MISSED)


def test_the_chosen_maneuver_is_the_first_completed_change_from_its_last_engagement():
    found = find_excerpt([road(PATIENT, QUICK, MISSED)])
    assert (found.command, found.vehicles) == (1, (8,))
    assert found.start == pytest.approx(9.0 - LEAD_TIME)
    assert found.end == pytest.approx(15.0 + FOLLOW_UP_TIME)
    only = find_excerpt([road(PATIENT, MISSED)])
    assert only.command == 0
    assert only.start == pytest.approx(20.0 - LEAD_TIME)


def test_a_given_maneuver_is_shown_from_its_first_engagement():
    found = find_excerpt([road(PATIENT, QUICK)], 0)
    assert (found.start, found.end) == pytest.approx((4.0 - LEAD_TIME, 26.0 + FOLLOW_UP_TIME))


def test_a_maneuver_that_never_engages_is_shown_from_its_command():
    found = find_excerpt([road(PATIENT, MISSED)], 2)
    assert (found.start, found.end) == pytest.approx((7.0 - LEAD_TIME, 20.0 + FOLLOW_UP_TIME))


def test_without_a_completed_change_the_first_engagement_is_chosen():
    lives = [(3, 0, {50: 2}, 80, Outcome.COLLISION), (4, 1, {10: 1, 20: 2}, 90, Outcome.MISSED)]
    assert find_excerpt([road(*lives)]).command == 1


def test_without_an_engagement_there_is_none():
    assert find_excerpt([road(MISSED)]) is None
    assert find_excerpt([new_rows(0)]) is None


def test_nothing_is_shown_before_the_road_begins():
    early = (5, 0, {0: 1, 5: 2}, 60, Outcome.COMPLETED)
    assert find_excerpt([road(early)]).start == 0.0


def test_several_roads_show_the_same_maneuver_from_the_first_start_to_the_last_end():
    later = (7, 1, {100: 2}, 300, Outcome.MISSED)
    found = find_excerpt([road(QUICK), road(later), road(PATIENT)])
    assert (found.command, found.vehicles) == (1, (8, 7, None))
    assert (found.start, found.end) == pytest.approx((9.0 - LEAD_TIME, 30.0 + FOLLOW_UP_TIME))


def test_a_maneuver_that_no_road_has_is_refused():
    with pytest.raises(TrajectoryError, match=r"maneuver = 4: must be a command of the road: 0, 1"):
        find_excerpt([road(PATIENT, QUICK)], 4)
    with pytest.raises(TrajectoryError, match=r"must be a command of the road: none"):
        find_excerpt([new_rows(0)], 0)


@pytest.mark.slow
def test_a_driven_lane_change_crosses_the_marking_in_its_excerpt():
    scenario = load_scenario("dense", {"num_agents": 1})
    driven = record_road(scenario, make_tuned_cascade_policy(scenario), name="tuned-cascade")
    found = find_excerpt([driven.rows])
    crossing = find_crossing(driven.rows, found)
    own = driven.rows[driven.rows["vehicle"] == found.vehicles[0]]
    now = own[np.isclose(own["time"], crossing)][0]
    assert now["phase"] == Phase.ENGAGED
    assert {now["lane_low"], now["lane_high"]} == {now["origin_lane"], now["target_lane"]}
    marking = scenario.road.lane_width * max(now["origin_lane"], now["target_lane"])
    assert now["lateral_position"] == pytest.approx(marking, abs=0.3)


@pytest.mark.slow
def test_who_keeps_its_lane_crosses_nothing():
    scenario = load_scenario("paper", {"num_agents": 1})
    driven = record_road(scenario, make_lane_keeping_policy(scenario), name="lane-keeping")
    found = find_excerpt([driven.rows])
    assert driven.rows["command"].max() != NONE
    assert find_crossing(driven.rows, found) == pytest.approx(0.5 * (found.start + found.end))
