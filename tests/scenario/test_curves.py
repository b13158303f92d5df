"""Roads with undrivable curves are rejected; on accepted roads vehicles keep their lanes."""

import numpy as np
import pytest

from marl_lanes.scenario import ScenarioError, load_scenario
from marl_lanes.scenario.curves import deviation_in_curves
from marl_lanes.scenario.schema import Scenario
from marl_lanes.traffic.simulator import Simulator

LATERAL = {"normal": 2.0, "aggressive": 3.0, "defensive": 1.5}
NO_COMMANDS = {"command": {"probability": 0.0}, "num_agents": None, "horizon": None}


def overrides_of(arcs, profile="normal", num_lanes=3, **keeping):
    return NO_COMMANDS | {
        "road": {"num_lanes": num_lanes, "arcs": arcs},
        "drivers": {"mix": {profile: 1.0}},
        "warmup": [60.0, 60.0],
        "lane_keeping": keeping,
    }


def s_curve(radius, transition, second=None, straight=0.0):
    start = 450.0 + straight
    return [
        {"start": 250.0, "end": 450.0, "radius": radius, "transition": transition},
        {"start": start, "end": 700.0, "radius": second or -radius, "transition": transition},
    ]


def largest_deviation(overrides, num_steps=600):
    simulator = Simulator("paper", 2, seed=1, overrides=overrides)
    simulator.reset()
    largest = 0.0
    for _ in range(num_steps):
        simulator.step()
        cars = simulator.vehicles[simulator.vehicles["id"] >= 0]
        error = np.abs(cars["lateral_position"] - 3.75 * (cars["lane"] + 0.5))
        largest = max(largest, error.max(initial=0.0))
    assert simulator.roads["num_left"].sum() > 10
    return largest, simulator.roads["num_off_road"].sum()


def predicted(overrides, profile):
    scenario = load_scenario("paper", overrides)
    keeping = scenario.lane_keeping
    found = deviation_in_curves(
        scenario.road.arcs,
        road_width=scenario.road.num_lanes * scenario.road.lane_width,
        lateral_acceleration=LATERAL[profile],
        top_speed=43.0,
        pole=keeping.pole,
        max_yaw_acceleration=keeping.max_yaw_acceleration,
    )
    return max(found)


@pytest.mark.parametrize(
    ("arcs", "profile", "keeping"),
    [
        (s_curve(400.0, 0.0), "normal", {}),
        (s_curve(-180.0, 0.0), "normal", {}),
        (s_curve(154.0, 0.0, -120.0), "normal", {}),
        (s_curve(-54.0, 0.0, 357.0), "defensive", {}),
        (s_curve(-85.0, 0.0, 52.0), "aggressive", {"max_yaw_acceleration": 1.0}),
        (s_curve(-65.0, 5.0, 300.0, 60.0), "aggressive", {"pole": 3.0}),
        (s_curve(70.0, 10.0), "normal", {"max_yaw_acceleration": 1.0}),
        (s_curve(100.0, 40.0), "aggressive", {}),
    ],
)
def test_the_predicted_deviation_is_that_of_the_simulation(arcs, profile, keeping):
    """Within 25 %, or on the safe side."""
    overrides = overrides_of(arcs, profile, **keeping)
    found, num_lost = largest_deviation(overrides)
    assert num_lost == 0
    assert 0.2 * predicted(overrides, profile) < found < 1.25 * predicted(overrides, profile)


@pytest.mark.parametrize("profile", LATERAL)
@pytest.mark.parametrize("transition", [0.0, 10.0, 50.0])
@pytest.mark.parametrize("num_lanes", [3, 5])
@pytest.mark.parametrize("radius", [50.0, -50.0, 100.0, -100.0, 200.0, 500.0])
def test_nobody_is_lost_on_an_accepted_road(radius, num_lanes, transition, profile):
    overrides = overrides_of(s_curve(radius, transition), profile, num_lanes)
    is_accepted = True
    try:
        load_scenario("paper", overrides)
    except ScenarioError as error:
        is_accepted = False
        message = str(error)
    if transition == 50.0 or (transition == 0.0 and abs(radius) >= 500.0):
        assert is_accepted
    if is_accepted:
        found, num_lost = largest_deviation(overrides)
        assert num_lost == 0
        assert found < 0.975
        return
    for part in ("road.arcs: radius = ", f"transition = {transition}", "0.78 m", f"{profile!r}"):
        assert part in message


def test_a_step_of_a_sharp_s_curve_is_refused_for_good_reason(monkeypatch):
    overrides = overrides_of(s_curve(50.0, 0.0), "aggressive")
    with pytest.raises(ScenarioError, match=r"radius = -50\.0 from 450\.0 with transition = 0\.0"):
        load_scenario("paper", overrides)
    monkeypatch.setattr(Scenario, "_check_curves", lambda _: None)
    assert largest_deviation(overrides)[1] > 5


def test_profiles_that_nobody_drives_refuse_nothing():
    road = {"arcs": s_curve(-180.0, 0.0)}
    profiles = {"racer": {"comfortable_lateral_acceleration": 4.0}}
    assert load_scenario("paper", {"road": road, "drivers": {"profiles": profiles}})
    with pytest.raises(ScenarioError, match="profile 'racer' of comfortable_lateral_acceleration"):
        load_scenario(
            "paper", {"road": road, "drivers": {"profiles": profiles, "mix": {"racer": 1.0}}}
        )


def test_a_driver_who_speeds_up_for_a_gap_takes_the_curve_faster():
    """On a wide curve only the top speed limits the speed, here 43.3 m/s times the factor."""
    road = {
        "road": {"arcs": [{"start": 250.0, "end": 700.0, "radius": -670.0, "transition": 0.0}]},
        "drivers": {"profiles": {"racer": {"comfortable_lateral_acceleration": 4.0}}},
        "lane_keeping": {"pole": 1.0},
    }
    road["drivers"]["mix"] = {"racer": 1.0}
    assert load_scenario("paper", road | {"gap": {"speed_factor": 1.0}})
    with pytest.raises(ScenarioError, match=r"deviates by 0\.9\d* m"):
        load_scenario("paper", road | {"gap": {"speed_factor": 1.1}})
