"""The gap rules: values by hand, which vehicles are in a lane, no collisions with them."""

import math

import numpy as np
import pytest
from staging import MIXED, TRUCK, command, damped_actions, simulator_of, stage

from marl_lanes.traffic.machine.state import Outcome, Phase
from marl_lanes.traffic.simulator import Simulator

ALWAYS = {"command": {"probability": 1.0}}
IDLE = {"desired_speed": 1e6}
"""Makes the free-road term almost 0; the acceleration in a step is at most a_m."""


def phase_beside(place, distance, phase, speeds, *, profile=0, **overrides):
    """Phase after a step of a changer in lane 1 with one neighbor, in lane 2.

    ``distance`` is bumper to bumper, after the step [m].
    """
    simulator = simulator_of(**overrides)
    own, other = speeds
    sign = 1.0 if place == "leader" else -1.0
    dt = simulator.scenario.time_step
    stage(
        simulator,
        {"lane": 1, "position": 200.0, "speed": own, **IDLE, "profile": profile},
        {
            "lane": 2,
            "position": 200.0 + sign * (4.8 + distance) + (own - other) * dt,
            "speed": other,
            **IDLE,
            "profile": profile,
        },
    )
    agent = command(simulator, 0, 1, phase)
    simulator.step()
    return Phase(int(simulator.agents[0, agent]["phase"]))


def safe_gap(rear, front, braking, *, s0=5.0, headway=1.0, a_m=2.0, b=1.5):
    """The gap at which Eq. 9 of the rear vehicle gives -braking, without free-road term [m]."""
    desired = s0 + max(0.0, rear * headway + rear * (rear - front) / (2.0 * math.sqrt(a_m * b)))
    return desired / math.sqrt(1.0 + braking / a_m)


def test_the_gap_of_the_law_by_hand():
    # s* = 5 + 20 = 25 m; 2 (1 - (25/s)^2) = -3 at s = 25/sqrt(2.5).
    assert safe_gap(20.0, 20.0, 3.0) == pytest.approx(15.8113883)
    # Closing with 4 m/s: 20 * 4/3.4641 = 23.094 m more; -4 at s = 48.094/sqrt(3).
    assert safe_gap(20.0, 16.0, 4.0) == pytest.approx(27.767079)


@pytest.mark.parametrize("place", ["leader", "follower"])
@pytest.mark.parametrize(("rear", "front"), [(20.0, 20.0), (20.0, 16.0), (16.0, 20.0)])
@pytest.mark.parametrize(
    ("before", "braking", "unsafe"),
    [(Phase.WAITING, 3.0, Phase.WAITING), (Phase.ENGAGED, 4.0, Phase.ABORTING)],
)
def test_the_law_is_the_limit_and_acceptance_keeps_a_margin(
    place, rear, front, before, braking, unsafe
):
    speeds = (rear, front) if place == "leader" else (front, rear)
    limit = safe_gap(rear, front, braking)
    # In the step the speeds change by 0.2 m/s, the gap by 0.02 m, and so the law a little.
    assert phase_beside(place, limit - 2.0, before, speeds) == unsafe
    assert phase_beside(place, limit + 2.0, before, speeds) == Phase.ENGAGED


@pytest.mark.parametrize(
    ("profile", "values"), [(1, (3.0, 0.6, 3.0, 2.5)), (2, (6.0, 1.6, 1.4, 1.2))]
)
def test_every_driver_has_its_own_limit(profile, values):
    s0, headway, a_m, b = values
    limit = safe_gap(20.0, 20.0, 3.0, s0=s0, headway=headway, a_m=a_m, b=b)
    mix = {"drivers": {"mix": {"normal": 1.0}}}
    for place in ("leader", "follower"):
        near = phase_beside(place, limit - 1.5, Phase.WAITING, (20.0, 20.0), profile=profile, **mix)
        far = phase_beside(place, limit + 1.5, Phase.WAITING, (20.0, 20.0), profile=profile, **mix)
        assert (near, far) == (Phase.WAITING, Phase.ENGAGED)


@pytest.mark.parametrize("safe", [2.0, 6.0])
def test_the_limit_is_the_scenarios(safe):
    gap = {"gap": {"safe_braking": safe, "braking_margin": 0.5}}
    limit = safe_gap(20.0, 20.0, safe - 0.5)
    assert phase_beside("leader", limit - 1.5, Phase.WAITING, (20.0, 20.0), **gap) == Phase.WAITING
    assert phase_beside("leader", limit + 1.5, Phase.WAITING, (20.0, 20.0), **gap) == Phase.ENGAGED


def test_the_standard_form_counts_the_free_road_term_as_well():
    """At v = v0 the standard IDM brakes harder: 2 (1 - 1 - (25/s)^2) = -3 at s = 25/sqrt(1.5)."""
    for form, limit in (("max", 25.0 / math.sqrt(2.5)), ("sum", 25.0 / math.sqrt(1.5))):
        for offset, expected in ((-1.5, Phase.WAITING), (1.5, Phase.ENGAGED)):
            simulator = simulator_of(drivers={"car_following": form})
            cruising = {"speed": 20.0, "desired_speed": 20.0}
            stage(
                simulator,
                {"lane": 1, "position": 200.0, **cruising},
                {"lane": 2, "position": 204.8 + limit + offset, **cruising},
            )
            agent = command(simulator, 0, 1, Phase.WAITING)
            simulator.step()
            assert simulator.agents[0, agent]["phase"] == expected


def test_bodies_closer_than_d_min_are_never_safe():
    """With the ACC model no other gap is required behind a leader that pulls away."""
    for gap, expected in ((1.5, Phase.WAITING), (2.6, Phase.ENGAGED)):
        found = phase_beside(
            "leader", gap, Phase.WAITING, (15.0, 20.0), drivers={"car_following": "acc"}
        )
        assert found == expected


@pytest.mark.parametrize(("gap", "phase"), [(11.0, Phase.WAITING), (12.0, Phase.ENGAGED)])
@pytest.mark.parametrize("place", ["leader", "follower"])
def test_rule_kinematic_accepts_from_the_required_gap_on(gap, phase, place):
    """At 20 m/s the required gap is 2 + 0.4 * 20 = 10 m, and 2 m more at 4 m/s closing speed."""
    simulator = simulator_of(gap={"rule": "kinematic"})
    # The free-road accelerations of the first step hardly change the speeds and the gap.
    speeds = {"leader": (20.0, 16.0), "follower": (16.0, 20.0)}[place]
    offset = 4.8 + gap + 0.5
    other = {"lane": 2, "position": 200.0 + (offset if place == "leader" else -offset)}
    slow = {"desired_speed": 1e6}
    stage(
        simulator,
        {"lane": 1, "position": 200.0, "speed": speeds[0], **slow},
        {**other, "speed": speeds[1], **slow},
    )
    agent = command(simulator, 0, 1, Phase.WAITING)
    simulator.step()
    assert simulator.agents[0, agent]["phase"] == phase


def test_two_changers_never_accept_the_same_gap():
    """Side by side in lanes 1 and 3 of five, both toward the empty lane 2: one has to wait."""
    simulator = simulator_of(road={"num_lanes": 5})
    stage(simulator, {"lane": 1, "position": 200.0}, {"lane": 3, "position": 203.0})
    command(simulator, 0, 1, Phase.WAITING)
    command(simulator, 1, -1, Phase.WAITING)
    simulator.step()
    # The front one comes first, in any slot.
    assert simulator.agents[0]["phase"][:2].tolist() == [Phase.WAITING, Phase.ENGAGED]
    assert simulator.agents[0, 0]["target_leader"] == 1


@pytest.mark.parametrize("name", ["five_lanes", "dense"])
def test_at_acceptance_the_gap_to_every_engaged_changer_is_wide_enough(name):
    overrides = {
        **ALWAYS,
        "departures": {"interval": [1.0, 3.0]},
        "num_agents": None,
        "num_slots": 24,
        "max_vehicles": 192,
        "gap": {"rule": "kinematic"},
    }
    simulator = Simulator(name, 24, seed=9, overrides=overrides)
    simulator.reset()
    pairs = 0
    was_engaged = simulator.agents["phase"] == Phase.ENGAGED
    for _ in range(250):
        simulator.step(damped_actions(simulator))
        is_engaged = simulator.agents["phase"] == Phase.ENGAGED
        for env, slot in np.argwhere(is_engaged & ~was_engaged):
            agents = simulator.agents[env]
            here = simulator.vehicles[env, agents[slot]["vehicle"]]
            for other in np.flatnonzero(is_engaged[env]):
                if other == slot or agents[other]["target_lane"] != agents[slot]["target_lane"]:
                    continue
                there = simulator.vehicles[env, agents[other]["vehicle"]]
                rear, front = sorted((here, there), key=lambda car: car["position"])
                closing = max(0.0, rear["speed"] - front["speed"])
                needed = 2.0 + 0.4 * rear["speed"] + closing**2 / 8.0
                assert front["position"] - rear["position"] - 4.8 >= needed
                pairs += 1
        was_engaged = is_engaged
    assert pairs > 50


def test_an_engaged_changer_from_the_other_side_counts_as_being_in_the_lane():
    """Both rules, both sides: the rear one sees the front one in its lane."""
    for rule in ("car_following", "kinematic"):
        for first, second in ((1, 3), (3, 1)):
            simulator = simulator_of(road={"num_lanes": 5}, gap={"rule": rule})
            stage(
                simulator, {"lane": first, "position": 200.0}, {"lane": second, "position": 190.0}
            )
            command(simulator, 0, 2 - first, Phase.WAITING)
            command(simulator, 1, 2 - second, Phase.WAITING)
            simulator.step()
            phases = simulator.agents[0]["phase"][:2].tolist()
            assert phases == [Phase.ENGAGED, Phase.WAITING]
            assert simulator.agents[0, 1]["target_leader"] == 0


@pytest.mark.slow
@pytest.mark.parametrize("rule", ["car_following", "kinematic"])
@pytest.mark.parametrize("form", ["max", "sum", "acc"])
def test_no_vehicle_collides_in_busy_traffic(rule, form):
    """Five crowded lanes, every driver profile and disposition, every vehicle commanded."""
    overrides = {
        **ALWAYS,
        "road": {"length": 800.0},
        "departures": {"interval": [1.0, 2.5], "initial_speed": [6.0, 25.0]},
        "drivers": {
            "car_following": form,
            "mix": {"normal": 1.0, "aggressive": 1.0, "defensive": 1.0},
        },
        "followers": {"mix": {"cooperative": 1.0, "neutral": 1.0, "adversarial": 2.0}},
        "completion": {"max_deviation": 0.2, "max_lateral_speed": 0.25, "max_yaw_rate": 0.03},
        "gap": {"rule": rule},
        "num_agents": None,
        "horizon": None,
        "num_slots": 24,
        "max_vehicles": 192,
    }
    simulator = Simulator("five_lanes", 12, seed=7, overrides=overrides)
    simulator.reset()
    completed = 0
    for _ in range(900):
        simulator.step(damped_actions(simulator))
        completed += int((simulator.agents["outcome"] == Outcome.COMPLETED).sum())
    assert simulator.roads["num_collisions"].sum() == 0
    assert completed > 300
    assert np.isfinite(simulator.vehicles["speed"]).all()


@pytest.mark.parametrize("place", ["leader", "follower"])
@pytest.mark.parametrize(("distance", "phase"), [(9.8, Phase.WAITING), (10.2, Phase.ENGAGED)])
def test_the_gap_beside_a_truck_is_from_its_bumper(place, distance, phase):
    """The rule kinematic needs 2 m + 0.4 s * 20 m/s between bumpers, 10.65 m within the bodies."""
    simulator = simulator_of(**MIXED, gap={"rule": "kinematic"})
    away = (10.65 + distance) * (1.0 if place == "leader" else -1.0)
    keeping = {"speed": 20.0, "desired_speed": 20.0}
    stage(
        simulator,
        {"lane": 1, "position": 200.0, **keeping},
        {"lane": 2, "position": 200.0 + away, **keeping, "profile": TRUCK},
    )
    agent = command(simulator, 0, 1, Phase.WAITING)
    simulator.step()
    cars = simulator.vehicles[0, :2]
    gap = abs(cars["position"][1] - cars["position"][0]) - 10.65
    assert gap == pytest.approx(distance, abs=0.05)
    assert simulator.agents[0, agent]["phase"] == phase
