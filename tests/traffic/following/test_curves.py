"""Drivers slow down for curves: the allowed speed, and how they keep it."""

import math

import numpy as np
import pytest

from marl_lanes.scenario import load_scenario
from marl_lanes.traffic.following.curves import curve_speed
from marl_lanes.traffic.parameters import make_parameters
from marl_lanes.traffic.road.geometry import curvature_at
from marl_lanes.traffic.simulator import Simulator

FREE = {
    "command": {"probability": 0.0},
    "num_agents": None,
    "horizon": None,
    "warmup": [0.0, 0.0],
    "departures": {"interval": [40.0, 40.0], "desired_speed": [30.0, 30.0]},
}
PROFILES = {"normal": (2.0, 1.5), "aggressive": (3.0, 2.5), "defensive": (1.5, 1.2)}


def arcs_of(*arcs):
    names = "start", "end", "radius", "transition"
    rows = [dict(zip(names, map(float, arc), strict=True)) for arc in arcs]
    return make_parameters(load_scenario("paper", {"road": {"arcs": rows}})).arcs


ROADS = {
    "step": arcs_of((300, 400, 150, 0)),
    "clothoids": arcs_of((300, 500, -150, 60)),
    "clothoids without a middle": arcs_of((300, 400, 80, 50)),
    "several": arcs_of((200, 300, 300, 40), (300, 420, -90, 30), (600, 700, 60, 50)),
}


@pytest.mark.parametrize("preview", [0.0, 25.0])
@pytest.mark.parametrize("lateral", [1.0, 9.0])
@pytest.mark.parametrize("arcs", ROADS.values(), ids=ROADS.keys())
def test_the_allowed_speed_is_the_least_over_all_positions_ahead(arcs, lateral, preview):
    """Compared with a scan of the road every 5 cm."""
    places = np.arange(0.0, 800.0, 0.05)
    curvature = np.array([curvature_at(arcs, place) for place in places])
    with np.errstate(divide="ignore"):
        path = np.abs(curvature / (1.0 - curvature * lateral))
        squares = np.where(path > 0.0, 2.0 / path, np.inf)
    checked = 0
    for position in np.arange(0.0, 800.0, 7.3):
        is_ahead = places >= position
        run = np.maximum(0.0, places[is_ahead] - position - preview)
        expected = math.sqrt((squares[is_ahead] + 2.0 * 1.5 * run).min())
        found = curve_speed(float(position), lateral, preview, 2.0, 1.5, arcs)
        if math.isinf(expected):
            assert math.isinf(found) or found > 100.0
            continue
        # Near an arc's end the scan is too coarse, because the curvature goes to 0 there.
        assert found <= expected * (1.0 + 1e-9)
        assert found == pytest.approx(expected, rel=2e-3 if expected < 60.0 else 0.1)
        checked += 1
    assert checked > 40


def drive(arcs, profile="normal", num_steps=700, scenario="paper", **overrides):
    """Rows (position, lateral position, speed, acceleration, yaw rate) of every single vehicle."""
    given = FREE | {"road": {"arcs": arcs}, "drivers": {"mix": {profile: 1.0}}} | overrides
    simulator = Simulator(scenario, seed=3, overrides=given)
    simulator.reset()
    tracks = {}
    for _ in range(num_steps):
        simulator.step()
        for car in simulator.vehicles[0]:
            if car["id"] >= 0:
                names = "position", "lateral_position", "speed", "acceleration", "yaw_rate"
                tracks.setdefault(int(car["id"]), []).append([float(car[x]) for x in names])
    assert simulator.roads["num_off_road"] == 0
    return [np.array(rows) for rows in tracks.values() if rows[-1][0] > 700.0]


@pytest.mark.parametrize("transition", [0.0, 50.0])
@pytest.mark.parametrize("radius", [100.0, -100.0, 250.0])
@pytest.mark.parametrize("profile", PROFILES)
def test_a_driver_brakes_comfortably_and_takes_the_curve_at_its_speed(profile, radius, transition):
    lateral, braking = PROFILES[profile]
    arcs = [{"start": 400.0, "end": 600.0, "radius": radius, "transition": transition}]
    tracks = drive(arcs, profile)
    assert tracks
    for rows in tracks:
        position, offset, speed, acceleration = rows[:, :4].T
        path = np.array([abs(radius) - math.copysign(1.0, radius) * d for d in offset])
        is_in_middle = (position > 400.0 + transition) & (position < 600.0 - transition)
        found = speed[is_in_middle] ** 2 / path[is_in_middle]
        found_speed = speed[is_in_middle][-1]
        # It uses the comfortable value fully, and hardly more, only at the end of the braking.
        assert found.max() < 1.05 * lateral
        assert found[-1] == pytest.approx(lateral, rel=0.01)
        # The path of an inner lane is shorter than the road.
        assert -1.06 * braking < acceleration.min() < -0.7 * braking
        assert np.diff(acceleration).min() > -4.0 / 0.5 * 0.1 * braking
        assert speed[position < 300.0].max() > 1.08 * found_speed
        assert speed[position > 700.0].max() > 1.04 * found_speed


def test_a_slow_driver_and_a_wide_curve_change_nothing():
    """At 30 m/s a radius of 500 m needs a lateral acceleration of 1.8 m/s^2."""
    arcs = [{"start": 400.0, "end": 600.0, "radius": 500.0}]
    bent, straight = drive(arcs), drive([])
    assert len(bent) == len(straight) > 1
    for one, other in zip(bent, straight, strict=True):
        size = min(len(one), len(other))
        np.testing.assert_allclose(one[:size, 2], other[:size, 2], rtol=1e-12)


def test_vehicles_enter_a_curve_at_its_speed():
    arcs = [{"start": 0.0, "end": 300.0, "radius": 50.0, "transition": 0.0}]
    departures = FREE["departures"] | {"initial_speed": [13.0, 13.0]}
    for rows in drive(arcs, departures=departures):
        _, lateral, speed, _, yaw_rate = rows[0]
        assert speed**2 / (50.0 - lateral) == pytest.approx(2.0)
        # It turns with the road from the beginning.
        assert yaw_rate == pytest.approx(speed / (50.0 - lateral))
        assert np.abs(rows[:80, 1] - lateral).max() < 1e-9


@pytest.mark.parametrize("scenario", ["curved", "interactive"])
def test_second_actions_and_adversarial_drivers_keep_the_speed_in_curves(scenario):
    """All second actions are 2 m/s^2, among adversarial followers."""
    arcs = [{"start": 200.0, "end": 700.0, "radius": 100.0}]
    simulator = Simulator(
        scenario,
        2,
        seed=0,
        overrides={
            "road": {"arcs": arcs},
            "followers": {"mix": {"adversarial": 1.0}},
            "action": {"longitudinal": {}},
            "command": {"probability": 1.0},
            "gap": {"minimum_gap": 2.0},
        },
    )
    simulator.reset()
    actions = np.zeros((2, simulator.num_slots, 2))
    actions[..., 1] = 2.0
    largest, num_seen = 0.0, 0
    for _ in range(500):
        simulator.step(actions)
        agents = simulator.agents[simulator.is_live]
        cars = simulator.vehicles[simulator.vehicles["id"] >= 0]
        inside = cars[(cars["position"] > 250.0) & (cars["position"] < 650.0)]
        found = inside["speed"] ** 2 / (100.0 - inside["lateral_position"])
        largest = max(largest, found.max(initial=0.0))
        num_seen += len(agents)
    assert num_seen > 200
    assert 1.9 < largest < 2.2


def test_an_unguarded_follower_may_drive_too_fast_in_a_curve():
    """With the guard the same policy keeps the speed in curves."""
    arcs = [{"start": 200.0, "end": 900.0, "radius": 50.0}]

    def lost(is_guarded):
        simulator = Simulator(
            "dense",
            8,
            seed=0,
            overrides={
                "road": {"arcs": arcs},
                "followers": {"mix": {"rude": 1.0}, "external": {"is_guarded": is_guarded}},
                "command": {"probability": 1.0},
            },
            follower_policies={"rude": lambda seen: np.full(len(seen), 3.0)},
        )
        simulator.reset()
        largest = 0.0
        for _ in range(300):
            paired = simulator.state.followers["vehicle"]
            simulator.step()
            for env, slot in np.argwhere(paired >= 0).tolist():
                car = simulator.vehicles[env, paired[env, slot]]
                bend = curvature_at(simulator.parameters.arcs, float(car["position"]))
                if car["id"] >= 0:
                    path = bend / (1.0 - bend * car["lateral_position"])
                    largest = max(largest, float(car["speed"] ** 2 * path))
        return largest

    assert 1.5 < lost(is_guarded=True) < 2.2
    assert lost(is_guarded=False) > 3.0
