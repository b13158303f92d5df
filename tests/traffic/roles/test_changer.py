"""The changer's observation and reward."""

from typing import get_args

import numpy as np
import pytest
from staging import command, damped_actions, simulator_of, stage

from marl_lanes.scenario.agent import FeatureName
from marl_lanes.traffic.machine.state import Phase
from marl_lanes.traffic.roles.changer import CHANGER
from marl_lanes.traffic.simulator import Simulator


def test_the_reward_is_the_sum_of_its_terms_by_hand():
    simulator = simulator_of()
    stage(simulator, {"lane": 1, "position": 200.0, "yaw_rate": 0.02})
    agent = command(simulator, 0, -1)
    simulator.step(np.full((1, simulator.num_slots, 1), 0.3))
    row = simulator.agents[0, agent]
    # To the right: the yaw acceleration is -0.3 rad/s^2, the yaw rate 0.02 - 0.03.
    speed = 20.0 + 0.2 * (1.0 - (2.0 / 3.0) ** 4)
    deviation = 3.75 + speed * np.sin(-0.001) * 0.1
    paid = CHANGER.terms_of(row)
    assert paid["reward_yaw_acceleration"] == pytest.approx(-2.0 * 0.3)
    assert paid["reward_yaw_rate"] == pytest.approx(-0.5 * 0.01)
    assert paid["reward_deviation"] == pytest.approx(-0.05 * deviation / 1.875)
    expected = -0.605 - 0.05 * deviation / 1.875
    assert row["reward"] == row["episode_reward"] == pytest.approx(expected)
    assert row["steering_steps"] == 1


def test_on_an_arc_only_turning_relative_to_the_road_is_punished():
    arcs = [{"start": 0.0, "end": 900.0, "radius": 400.0}]
    simulator = simulator_of(road={"arcs": arcs})
    rate = 20.0 / (400.0 - 5.625)
    stage(simulator, {"lane": 1, "position": 200.0, "yaw_rate": rate, "desired_speed": 20.0})
    agent = command(simulator, 0, 1)
    simulator.step()
    assert simulator.vehicles[0, 0]["yaw_rate"] == pytest.approx(rate)
    paid = CHANGER.terms_of(simulator.agents[0, agent])
    assert paid["reward_yaw_rate"] == pytest.approx(0.0, abs=1e-12)


def test_braking_at_a_standstill_has_no_effect():
    """At a standstill a changer that brakes and one with action 0 have the same state."""
    ends = []
    for wanted in (-3.0, 0.0):
        simulator = Simulator(
            "interactive", seed=1, overrides={"num_agents": None, "horizon": None}
        )
        simulator.reset()
        simulator.advance_until_live()
        slot = int(np.argmax(simulator.is_live[0]))
        for count in range(350):
            acceleration = -3.0 if count < 250 else wanted
            simulator.step(np.full((1, simulator.num_slots, 2), [0.0, acceleration]))
        car = simulator.vehicles[0, simulator.agents[0, slot]["vehicle"]]
        assert car["speed"] == car["acceleration"] == 0.0
        ends.append(simulator.snapshot())
        # No leader makes it stop: car following would drive on.
        assert simulator.agents[0, slot]["car_following"] > 0.0
    assert ends[0] == ends[1]


def test_car_following_behind_a_stopped_leader_keeps_the_driver_stopped():
    simulator = Simulator("interactive", overrides={"warmup": [0.0, 0.0]}, seed=0)
    simulator.reset()
    stage(
        simulator,
        {"lane": 1, "position": 100.0, "speed": 0.0},
        {"lane": 1, "position": 106.0, "speed": 0.0, "desired_speed": 0.01},
    )
    agent = command(simulator, 0, 1, Phase.WAITING)
    simulator.step(np.full((1, simulator.num_slots, 2), [0.0, -3.0]))
    column = list(simulator.scenario.observation.features).index("car_following_acceleration")
    assert simulator.agents[0, agent]["car_following"] == 0.0
    assert simulator.state.observations[0, agent, column] == 0.0
    assert CHANGER.terms_of(simulator.agents[0, agent])["reward_longitudinal"] == 0.0


def test_the_observed_car_following_is_the_one_that_is_driven():
    """A waiting agent observes its acceleration of the next step without a second action."""
    features = {"observation": {"features": ["car_following_acceleration", "phase"]}}
    overrides = {
        **features,
        "command": {"probability": 1.0},
        "drivers": {"mix": {"normal": 1.0, "aggressive": 1.0, "defensive": 1.0}},
        "followers": {"mix": {"neutral": 1.0}},
    }
    simulator = Simulator("dense", 8, seed=3, overrides=overrides)
    simulator.reset()
    compared = 0
    for _ in range(300):
        seen = simulator.state.observations.copy()
        vehicles = simulator.agents["vehicle"].copy()
        alone = (simulator.roads["num_live"] == 1)[:, None] & (seen[..., 1] == Phase.WAITING)
        simulator.step(damped_actions(simulator))
        for env, slot in np.argwhere(alone):
            found = simulator.vehicles[env, vehicles[env, slot]]["acceleration"]
            assert found == pytest.approx(seen[env, slot, 0], abs=1e-5)
            compared += 1
    assert compared > 100


def test_a_scenario_can_name_every_feature_and_no_other():
    assert get_args(FeatureName) == tuple(feature.name for feature in CHANGER.features)


@pytest.mark.parametrize("direction", [1, -1])
def test_features_are_relative_to_the_maneuver(direction):
    """Lateral ones are positive toward the target lane; without a neighbor the gap is the range."""
    names = [feature.name for feature in CHANGER.features]
    simulator = simulator_of(observation={"features": names, "sensor_range": 60.0})
    stage(
        simulator,
        {"lane": 1, "position": 200.0, "yaw": 0.01, "yaw_rate": 0.02},
        {"lane": 1, "position": 240.0, "speed": 17.0},
        {"lane": 1 + direction, "position": 120.0, "speed": 26.0},
    )
    agent = command(simulator, 0, direction)
    simulator.step(np.full((1, simulator.num_slots, 1), 0.1))
    car, leader, behind = simulator.vehicles[0, :3]
    wanted = {
        "speed": car["speed"],
        "acceleration": car["acceleration"],
        "lateral_deviation": direction * (5.625 + 3.75 * direction - car["lateral_position"]),
        "lateral_speed": direction * car["speed"] * np.sin(car["yaw"]),
        "yaw": direction * car["yaw"],
        "yaw_rate": direction * car["yaw_rate"],
        "curvature": 0.0,
        "leader_gap": leader["position"] - car["position"] - 4.8,
        "leader_relative_speed": leader["speed"] - car["speed"],
        "follower_gap": 60.0,
        "follower_relative_speed": 0.0,
        "target_leader_gap": 60.0,
        "target_leader_relative_speed": 0.0,
        # It is 75 m behind, beyond the range.
        "target_follower_gap": 60.0,
        "target_follower_relative_speed": behind["speed"] - car["speed"],
        "phase": Phase.ENGAGED,
        "time": 0.1,
        "distance_to_end": 1000.0 - car["position"],
    }
    seen = dict(zip(names, simulator.state.observations[0, agent].tolist(), strict=True))
    del seen["car_following_acceleration"]
    assert seen == pytest.approx(wanted, rel=1e-6, abs=1e-7)


def test_an_agent_sees_its_own_last_observations_newest_first():
    """Also in a slot that another agent had just before, and in the step that ends it."""
    crowd = {"command": {"probability": 1.0}, "num_slots": 2, "num_agents": None, "horizon": None}
    crowd["road"] = {"length": 250.0}
    crowd["observation"] = {"features": ["speed", "time", "phase"], "num_stacked": 3}
    simulator = Simulator("hidden", 2, seed=1, overrides=crowd)
    simulator.reset()
    kept, num_reused, num_ended = {}, 0, 0
    for _ in range(300):
        had_agent = simulator.agents["command"].copy()
        simulator.step()
        seen = simulator.state.observations.reshape(2, 2, 3, 3)
        for road, slot in np.ndindex(2, 2):
            agent = simulator.agents[road, slot]
            if agent["vehicle"] < 0:
                assert not seen[road, slot].any()
                continue
            key = road, int(agent["command"])
            num_reused += key not in kept and had_agent[road, slot] >= 0
            num_ended += int(agent["outcome"]) > 0
            history = kept.setdefault(key, [])
            history.insert(0, seen[road, slot, 0].tolist())
            padded = [*history, *[history[-1]] * 2][:3]
            assert seen[road, slot].tolist() == padded
    assert num_reused > 2
    assert num_ended > 4
