"""Acceleration of the vehicle behind an engaged changer, by its disposition."""

import math

import pytest
from staging import command, stage

from marl_lanes.traffic.machine.state import Disposition, Phase
from marl_lanes.traffic.simulator import Simulator

OPEN_GAP = {"rule": "kinematic", "minimum_gap": 0.0, "time_gap": 0.0, "max_braking": 1000.0}
FREE = 2.0 * (1.0 - (20.0 / 30.0) ** 4)
"""[m/s^2] at 20 m/s on a free road, desired speed 30 m/s."""


def simulator_of(**overrides):
    simulator = Simulator(
        "paper", overrides={"warmup": [0.0, 0.0], "gap": OPEN_GAP, **overrides}, seed=0
    )
    simulator.reset()
    return simulator


def following(
    disposition, *, phase=Phase.ENGAGED, lateral=5.625, gap=10.2, speeds=(20.0, 15.0), **overrides
):
    """Acceleration of the follower in lane 2 behind a changer in lane 1, engaged by default."""
    simulator = simulator_of(**overrides)
    follower = {"lane": 2, "position": 100.0, "speed": speeds[0], "disposition": disposition}
    changer = {"lane": 1, "position": 104.8 + gap, "speed": speeds[1], "lateral_position": lateral}
    stage(simulator, follower, changer)
    command(simulator, 1, 1, phase)
    # The step before has set whose follower it is.
    simulator.vehicles[0, 0]["changer"] = 1 if phase == Phase.ENGAGED else -1
    simulator.step()
    assert simulator.roads["num_vehicles"][0] == 2
    return simulator.vehicles[0, 0]["acceleration"]


def law(speed, gap, closing, *, headway=1.0):
    """The interaction branch of Eq. 9 with the paper's numbers."""
    desired = 5.0 + speed * headway + speed * closing / (2.0 * math.sqrt(3.0))
    return 2.0 * (1.0 - (desired / gap) ** 2)


def test_engagement_makes_the_vehicle_behind_the_follower():
    simulator = simulator_of()
    stage(
        simulator,
        {"lane": 2, "position": 80.0},
        {"lane": 2, "position": 60.0},
        {"lane": 1, "position": 110.0, "speed": 20.0},
        {"lane": 0, "position": 90.0},
    )
    agent = command(simulator, 2, 1, Phase.WAITING)
    simulator.step()
    assert simulator.agents[0, agent]["phase"] == Phase.ENGAGED
    assert simulator.agents[0, agent]["target_follower"] == 0
    assert simulator.vehicles[0]["changer"][:4].tolist() == [2, -1, -1, -1]


def test_a_follower_of_two_changers_yields_to_the_nearer():
    simulator = simulator_of(road={"num_lanes": 5})
    stage(
        simulator,
        {"lane": 2, "position": 80.0},
        {"lane": 1, "position": 130.0},
        {"lane": 3, "position": 110.0},
    )
    command(simulator, 1, 1)
    command(simulator, 2, -1)
    simulator.step()
    # The farther changer's own follower is the nearer one, engaged toward the same lane.
    assert simulator.vehicles[0]["changer"][:3].tolist() == [2, -1, 1]


def test_neutral_ignores_the_changer_until_its_body_overlaps_the_lane():
    assert following(Disposition.NEUTRAL) == pytest.approx(FREE)
    # 7.5 - 0.9 is where the body touches the marking.
    assert following(Disposition.NEUTRAL, lateral=6.59) == pytest.approx(FREE)
    expected = max(law(20.0, 10.2, 5.0), -8.0)
    assert following(Disposition.NEUTRAL, lateral=6.61) == pytest.approx(expected)


def test_neutral_follows_the_law_behind_a_body_in_its_lane():
    found = following(Disposition.NEUTRAL, lateral=7.0, gap=30.0, speeds=(20.0, 18.0))
    assert found == pytest.approx(law(20.0, 30.0, 2.0))
    assert -8.0 < found < 0.0


def test_cooperative_brakes_from_engagement_on_but_gently():
    assert following(Disposition.COOPERATIVE) == pytest.approx(-2.0)
    found = following(Disposition.COOPERATIVE, gap=40.0, speeds=(20.0, 20.0))
    assert found == pytest.approx(law(20.0, 40.0, 0.0, headway=1.5))
    assert found < FREE


def test_cooperative_does_nothing_before_engagement():
    assert following(Disposition.COOPERATIVE, phase=Phase.WAITING) == pytest.approx(FREE)


def test_cooperative_brakes_as_hard_as_necessary_once_the_body_is_in():
    assert following(Disposition.COOPERATIVE, lateral=6.61) == -8.0


@pytest.mark.parametrize("limit", [0.5, 3.0])
def test_the_cooperative_limit_is_the_scenarios(limit):
    followers = {"cooperative": {"max_braking": limit}}
    assert following(Disposition.COOPERATIVE, followers=followers) == pytest.approx(-limit)


def test_cooperative_still_brakes_fully_for_its_own_leader():
    simulator = simulator_of()
    stage(
        simulator,
        {"lane": 2, "position": 100.0, "disposition": Disposition.COOPERATIVE, "changer": 1},
        {"lane": 1, "position": 115.0},
        {"lane": 2, "position": 116.0, "speed": 10.0},
    )
    command(simulator, 1, 1)
    simulator.step()
    assert simulator.vehicles[0, 0]["acceleration"] == -8.0


def test_adversarial_accelerates_harder_than_neutral_then_brakes():
    found = following(Disposition.ADVERSARIAL)
    assert found == pytest.approx(3.0 * (1.0 - (20.0 / 39.0) ** 4))
    assert found > following(Disposition.NEUTRAL)
    braking = following(Disposition.ADVERSARIAL, lateral=6.61)
    assert braking == following(Disposition.NEUTRAL, lateral=6.61)
    assert braking == -8.0


def test_adversarial_drives_plainly_without_a_changer():
    assert following(Disposition.ADVERSARIAL, phase=Phase.WAITING) == pytest.approx(FREE)


def test_adversarial_keeps_a_shorter_headway_to_its_own_leader():
    simulator = simulator_of()
    stage(
        simulator,
        {"lane": 2, "position": 100.0, "disposition": Disposition.ADVERSARIAL, "changer": 1},
        {"lane": 1, "position": 115.0},
        {"lane": 2, "position": 124.8, "speed": 20.0},
    )
    command(simulator, 1, 1)
    simulator.step()
    # s* = 5 + 20 * 0.5 = 15 at a gap of 20; plain following (s* = 25) would brake.
    assert simulator.vehicles[0, 0]["acceleration"] == pytest.approx(3.0 * (1.0 - 0.75**2))


@pytest.mark.parametrize(
    ("phase", "expected"), [(Phase.WAITING, 0.0), (Phase.ENGAGED, law(20.0, 30.0, 0.0))]
)
def test_closing_a_gap_does_not_change_what_a_driver_does_for_its_own_target_lane(phase, expected):
    """An adversarial driver with a command, behind a changer.

    If engaged, it follows the target lane's leader with a_m, T and v0 of its profile. If waiting,
    it keeps the pace of the gap beside it.
    """
    simulator = simulator_of(road={"num_lanes": 4})
    stage(
        simulator,
        {"lane": 2, "position": 100.0, "disposition": Disposition.ADVERSARIAL, "changer": 1},
        {"lane": 3, "position": 200.0},
        {"lane": 1, "position": 134.8, "speed": 20.0},
    )
    command(simulator, 0, -1, phase)
    command(simulator, 1, -1, Phase.ENGAGED)
    simulator.step()
    assert simulator.vehicles[0, 0]["acceleration"] == pytest.approx(expected, abs=1e-12)


def test_a_waiting_adversarial_driver_still_closes_the_gap():
    simulator = simulator_of(road={"num_lanes": 4}, gap={"minimum_gap": 500.0})
    stage(
        simulator,
        {"lane": 2, "position": 100.0, "disposition": Disposition.ADVERSARIAL, "changer": 1},
        {"lane": 3, "position": 200.0},
    )
    command(simulator, 0, -1, Phase.WAITING)
    command(simulator, 1, -1, Phase.ENGAGED)
    simulator.step()
    expected = 3.0 * (1.0 - (20.0 / 39.0) ** 4)
    assert simulator.vehicles[0, 0]["acceleration"] == pytest.approx(expected)


def test_a_changer_follows_the_nearer_of_the_leaders_in_both_lanes():
    for lanes, expected in (((1, 2), 25.2), ((2, 1), 25.2)):
        simulator = simulator_of()
        stage(
            simulator,
            {"lane": 1, "position": 100.0},
            {"lane": lanes[0], "position": 130.0},
            {"lane": lanes[1], "position": 160.0},
        )
        command(simulator, 0, 1)
        simulator.step()
        assert simulator.vehicles[0, 0]["acceleration"] == pytest.approx(law(20.0, expected, 0.0))


def test_a_waiting_driver_brakes_for_its_own_leader_as_hard_as_necessary():
    simulator = simulator_of()
    stage(
        simulator,
        {"lane": 1, "position": 100.0},
        {"lane": 1, "position": 113.0, "speed": 12.0},
        {"lane": 2, "position": 160.0},
    )
    command(simulator, 0, 1, Phase.WAITING)
    simulator.step()
    assert simulator.vehicles[0, 0]["acceleration"] == -8.0


def test_a_body_in_two_lanes_follows_and_is_followed_in_both():
    simulator = simulator_of()
    stage(
        simulator,
        {"lane": 1, "position": 100.0, "lateral_position": 7.5},
        {"lane": 2, "position": 130.0},
        {"lane": 1, "position": 70.0},
        {"lane": 2, "position": 66.0},
        {"lane": 0, "position": 70.0},
    )
    simulator.step()
    found = simulator.vehicles[0]["acceleration"][[0, 2, 3, 4]]
    expected = [law(20.0, 25.2, 0.0), law(20.0, 25.2, 0.0), law(20.0, 29.2, 0.0), FREE]
    assert found == pytest.approx(expected)


def test_acceleration_is_bounded_by_the_physical_limit():
    simulator = simulator_of(vehicle={"max_braking": 5.0})
    stage(
        simulator,
        {"lane": 1, "position": 100.0, "speed": 30.0},
        {"lane": 1, "position": 120.0, "speed": 0.0},
    )
    simulator.step()
    assert simulator.vehicles[0, 0]["acceleration"] == -5.0
