"""Acceleration of a waiting driver toward a gap in its target lane."""

import math

import numpy as np
import pytest
from staging import TRUCK, command, damped_actions, stage

from marl_lanes.scenario import load_scenario
from marl_lanes.traffic.driving.gap_seeking import aim_at, needed_gap, travel_time
from marl_lanes.traffic.machine.compiled import compiled, on_columns
from marl_lanes.traffic.machine.state import Outcome, Phase
from marl_lanes.traffic.parameters import make_parameters
from marl_lanes.traffic.simulator import Simulator

NEVER = {"gap": {"minimum_gap": 5000.0}}
FREE = 2.0 * (1.0 - (20.0 / 33.0) ** 4)
"""[m/s^2] at 20 m/s on a free road with 1.1 times the desired speed of 30 m/s."""


def simulator_of(name="paper", **overrides):
    simulator = Simulator(name, overrides={"warmup": [0.0, 0.0], **overrides}, seed=0)
    simulator.reset()
    return simulator


def waiting(*others, own=None, phase=Phase.WAITING, **overrides):
    """Acceleration of a driver that waits at 200 m in lane 1 for lane 2, at 20 m/s."""
    simulator = simulator_of(**overrides)
    stage(simulator, {"lane": 1, "position": 200.0, **(own or {})}, *others)
    command(simulator, 0, 1, phase)
    simulator.step()
    return float(simulator.vehicles[0, 0]["acceleration"])


def there(position, speed=20.0, lane=2):
    return {"lane": lane, "position": position, "speed": speed}


NEED = 25.0 / math.sqrt(2.5)
"""[m] Gap at which Eq. 9 gives -3 m/s^2, if both vehicles drive at 20 m/s."""


@pytest.mark.parametrize(
    ("distance", "speed", "top", "expected"),
    [
        (0.0, 0.0, 9.0, 0.0),
        # Accelerates half of the distance, brakes the other half: 2 sqrt(16/1).
        (16.0, 0.0, 9.0, 8.0),
        (-16.0, 0.0, 9.0, 8.0),
        # Only brakes: 4 m/s in 4 s over 8 m.
        (8.0, 4.0, 9.0, 4.0),
        # Passes the point and comes back: 4 s to a stop at 8 m, then 2 sqrt(8).
        (0.0, 4.0, 9.0, 4.0 + 2.0 * math.sqrt(8.0)),
        # First stops in the wrong direction: 4 s, 8 m away, then 2 sqrt(16).
        (8.0, -4.0, 9.0, 4.0 + 8.0),
        # At most 2 m/s: 2 s accelerating and 2 s braking over 4 m, the other 12 m in 6 s.
        (16.0, 0.0, 2.0, 10.0),
        (-16.0, 0.0, 2.0, 10.0),
        (16.0, 0.0, 0.0, math.inf),
    ],
)
def test_travel_time_by_hand(distance, speed, top, expected):
    assert travel_time(distance, speed, 1.0, top) == pytest.approx(expected)


def test_it_falls_back_behind_the_vehicle_beside_it_gently():
    """There is no other vehicle; the window behind is reached sooner than the one ahead."""
    # The window's edge is 4.8 + NEED m behind 203 m, the aim 3 m further.
    aim = 203.0 - 4.8 - NEED - 3.0 - 200.0
    assert aim == pytest.approx(-20.61, abs=0.01)
    assert waiting(there(203.0)) == pytest.approx(max(aim / 5.0, -1.5))
    near = 203.0 + 17.0
    aim = near - 4.8 - NEED - 3.0 - 200.0
    assert waiting(there(near)) == pytest.approx(aim / 5.0)
    assert -1.5 < aim / 5.0 < 0.0


def test_it_speeds_up_to_get_ahead_of_the_vehicle_beside_it():
    assert waiting(there(197.0)) == pytest.approx(FREE)
    # Close to the edge it accelerates only as much as necessary: the aim is 2 + 3 m ahead.
    rear = 200.0 - 4.8 - NEED + 2.0
    assert waiting(there(rear)) == pytest.approx(5.0 / 5.0)


def test_for_a_gap_it_drives_faster_than_its_desired_speed_up_to_the_factor():
    own = {"speed": 30.0, "desired_speed": 30.0}
    found = waiting(there(185.0, 30.0), own=own)
    assert found == pytest.approx(2.0 * (1.0 - (30.0 / 33.0) ** 4))
    fixed = {"gap": {"speed_factor": 1.0}}
    # It cannot overtake, so it falls back.
    assert waiting(there(185.0, 30.0), own=own, **fixed) == pytest.approx(-1.5)


def test_a_vehicle_faster_than_the_drivers_top_speed_is_let_by():
    """At 22 m/s at most it cannot get ahead of 30 m/s: it waits for the gap behind."""
    own = {"speed": 20.0, "desired_speed": 20.0}
    assert waiting(there(190.0, 30.0), own=own) <= 0.0


def test_the_own_leader_can_be_in_the_way_of_the_gap_ahead():
    """The window ahead is nearer, but the own leader is in the way."""
    assert waiting(there(197.0)) > 1.0
    # The leader is 25 m ahead, the gap of car following at 20 m/s: there is no room to gain.
    assert waiting(there(197.0), there(229.8, lane=1)) == pytest.approx(-1.5)


def test_the_own_leader_is_followed_whatever_the_gap():
    found = waiting(there(197.0), {"lane": 1, "position": 214.0, "speed": 12.0})
    assert found == -8.0


def test_of_three_gaps_the_one_reached_soonest_is_sought():
    wide = 2.0 * NEED + 4.8
    # The gap beside is too narrow, the next one behind is wide enough, the one ahead is far.
    behind = [there(215.0), there(190.0), there(190.0 - wide - 8.0), there(300.0)]
    assert waiting(*behind) == pytest.approx(-1.5)
    # The other way round.
    ahead = [there(185.0), there(210.0), there(210.0 + wide + 8.0), there(100.0), there(140.0)]
    assert waiting(*ahead) == pytest.approx(FREE)


def test_without_a_gap_in_sight_it_drives_on():
    """A lane of vehicles 20 m apart within sensor range: no window, plain car following."""
    lane = [there(position) for position in range(0, 420, 20)]
    plain = 2.0 * (1.0 - (20.0 / 30.0) ** 4)
    assert waiting(*lane) == pytest.approx(plain)
    assert waiting(*lane, **NEVER) == pytest.approx(plain)


def test_for_a_gap_it_never_brakes_harder_than_comfortably():
    found = waiting(there(204.0, 5.0), own={"profile": 1})
    assert found == pytest.approx(-2.5)
    assert waiting(there(204.0, 5.0)) == pytest.approx(-1.5)


def test_an_engaged_changer_brakes_gently_for_the_target_lane_until_it_is_there():
    """29.2 m behind a leader that is 3 m/s slower: Eq. 9 gives -2.2 m/s^2."""
    leader = there(234.0, 17.0)
    gap = 234.0 - 200.0 - 4.8
    law = 2.0 * (1.0 - ((25.0 + 20.0 * 3.0 / (2.0 * math.sqrt(3.0))) / gap) ** 2)
    assert -4.0 < law < -1.5
    assert waiting(leader, phase=Phase.ENGAGED) == pytest.approx(-1.5)
    inside = {"lateral_position": 7.0}
    assert waiting(leader, own=inside, phase=Phase.ENGAGED) == pytest.approx(law)


def test_an_engaged_changer_keeps_the_speed_that_it_reached_for_the_gap():
    own = {"speed": 21.0, "desired_speed": 20.0}
    slower = 2.0 * (1.0 - (21.0 / 20.0) ** 4)
    assert waiting(own=own, phase=Phase.ENGAGED) == pytest.approx(0.0, abs=1e-12)
    inside = {**own, "lateral_position": 7.0}
    assert waiting(own=inside, phase=Phase.ENGAGED) == pytest.approx(slower)


def test_in_dense_traffic_waiting_drivers_find_gaps_without_hard_braking():
    settled = {"max_deviation": 0.2, "max_lateral_speed": 0.25, "max_yaw_rate": 0.03}
    simulator = Simulator("dense", 40, seed=0, overrides={"completion": settled})
    simulator.reset()
    outcomes, hardest = [], 0.0
    while not simulator.roads["is_done"].all():
        simulator.step(damped_actions(simulator))
        outcomes += simulator.agents["outcome"][simulator.has_ended].tolist()
        for env, slot in np.argwhere(simulator.agents["phase"] == Phase.ENGAGED):
            agent = simulator.agents[env, slot]
            hardest = max(hardest, -simulator.vehicles[env, agent["vehicle"]]["acceleration"])
    assert len(outcomes) == 400
    assert outcomes.count(Outcome.MISSED) <= 12
    assert outcomes.count(Outcome.COMPLETED) >= 388
    assert hardest < 4.5


@pytest.mark.parametrize("form", ["max", "sum", "acc"])
@pytest.mark.parametrize("phase", [Phase.WAITING, Phase.ENGAGED])
@pytest.mark.parametrize("places", [(230.0,), (150.0,), (230.0, 150.0)])
def test_where_no_gap_is_wide_enough_for_a_driver_the_acceleration_is_finite(form, phase, places):
    """Drivers three times as fast as they wish accept no gap: the windows are infinitely far."""
    hasty = {"desired_speed": 8.0}
    acceleration = waiting(
        *({**there(place, 24.0), **hasty} for place in places),
        own={**hasty, "speed": 24.0},
        phase=phase,
        drivers={"car_following": form},
    )
    assert -8.0 <= acceleration <= 2.0


@compiled
def aims(simulated, front, rear, order, profiles, constants):
    return aim_at(simulated[0], front, rear, order, simulated, profiles, constants)


@pytest.mark.parametrize(
    ("front", "rear", "aim"), [(0, -1, -math.inf), (-1, 2, math.inf), (0, 2, 0.0)]
)
def test_without_a_gap_wide_enough_the_aim_is_away_from_who_needs_it(front, rear, aim):
    """At twice its v0 or more no driver accepts a gap, whichever side it is on."""
    simulator = simulator_of(drivers={"car_following": "sum"}, gap={"speed_factor": 2.0})
    hasty = {"speed": 24.0, "desired_speed": 8.0}
    places = [{"lane": 2, "position": place, **hasty} for place in (230.0, 150.0)]
    stage(simulator, {"lane": 1, "position": 200.0, **hasty}, *places)
    profiles, constants = simulator.parameters.profiles, simulator.parameters.constants[0]
    order = simulator.state.order[0]
    _, way, found = aims(simulator.vehicles[0], front, rear, order, profiles, constants)
    assert (way, found) == (math.inf, aim)


@pytest.mark.parametrize(("closing", "gap"), [(-4.0, 10.0), (0.0, 10.0), (0.5, 10.03125)])
def test_the_kinematic_gap_by_hand(closing, gap):
    """d_min + 0.4 s * 20 m/s, and closing^2/(2 * 4 m/s^2)."""
    scenario = load_scenario("paper", {"gap": {"rule": "kinematic"}})
    constants = make_parameters(scenario).constants.view(np.recarray)[0]
    assert on_columns(needed_gap)(20.0, closing, 30.0, None, constants) == pytest.approx(gap)


@pytest.mark.parametrize(("own", "other"), [(0, TRUCK), (TRUCK, 0)])
def test_the_window_is_between_bumpers(own, other):
    """The rule kinematic needs 2 m + 0.4 s * 20 m/s; the aim is 3 m within the window's edge."""
    simulator = simulator_of(gap={"rule": "kinematic"})
    half = {0: 2.4, TRUCK: 8.25}
    there = {"lane": 2, "speed": 20.0}
    stage(
        simulator,
        {"lane": 1, "position": 200.0, "profile": own},
        {**there, "position": 290.0, "profile": other},
        {**there, "position": 210.0, "profile": other},
    )
    profiles, constants = simulator.parameters.profiles, simulator.parameters.constants[0]
    order = simulator.state.order[0]
    _, way, aim = aims(simulator.vehicles[0], 0, 1, order, profiles, constants)
    assert way == pytest.approx(210.0 + half[other] + 10.0 + half[own] - 200.0)
    assert aim == pytest.approx(way + 3.0)
    _, way, _ = aims(simulator.vehicles[0], 0, -1, order, profiles, constants)
    assert way == 0.0
    _, way, aim = aims(simulator.vehicles[0], 1, -1, order, profiles, constants)
    assert way == pytest.approx(210.0 - half[other] - 10.0 - half[own] - 200.0)
