"""The kernel compared with the reference, each step beginning from the kernel's own state."""

from dataclasses import dataclass, field

import numpy as np
import pytest
from comparing import (
    EVERY_FEATURE,
    compare_agents,
    compare_followers,
    compare_road,
    compare_vehicles,
    met_behind,
    met_beside,
    met_by_agents,
    moving_over,
)
from reference.road import Road
from staging import command, damped_actions, stage

from marl_lanes.scenario import list_scenarios
from marl_lanes.traffic.machine.state import Disposition
from marl_lanes.traffic.simulator import Simulator

STACKED = {**EVERY_FEATURE, "num_stacked": 3}
GRIDDED = {
    "features": ["speed"],
    "num_stacked": 2,
    "grid": {"num_lanes": 5, "num_stretches": 7, "stretch": 6.0},
}
MIXED = {
    "drivers": {"mix": {"normal": 1.0, "aggressive": 1.0, "defensive": 1.0}},
    "followers": {"mix": {"cooperative": 1.0, "neutral": 1.0, "adversarial": 1.0}},
    "observation": EVERY_FEATURE,
    "command": {"probability": 0.9},
}
BUSY = {
    **MIXED,
    "road": {"num_lanes": 5, "length": 500.0},
    "departures": {"interval": [1.0, 2.5], "initial_speed": [6.0, 14.0]},
    "warmup": [20.0, 30.0],
    "num_agents": None,
    "max_vehicles": 40,
    "num_slots": 4,
    "horizon": None,
}
ARCS = [
    {"start": 60.0, "end": 230.0, "radius": 200.0},
    {"start": 230.0, "end": 450.0, "radius": -120.0},
]
STEPPED = [
    {"start": 0.0, "end": 60.0, "radius": -80.0, "transition": 0.0},
    {"start": 160.0, "end": 190.0, "radius": 90.0, "transition": 15.0},
    {"start": 300.0, "end": 450.0, "radius": 150.0, "transition": 0.0},
]


LONGITUDINAL = {"action": {"longitudinal": {"max_speed": 24.0}}}
PAID = {"reward": {"delay_weight": 0.7, "longitudinal_weight": 0.3}}
CROWDED = {
    **BUSY,
    "departures": {"interval": [0.5, 1.2], "initial_speed": [6.0, 14.0]},
    "max_vehicles": 60,
    "num_slots": 6,
    "gap": {"rule": "kinematic", "minimum_gap": 0.5, "time_gap": 0.1},
}
RECKLESS = {"max_acceleration": 5.0, "max_braking": 6.0, "max_speed": 30.0, "is_guarded": False}
OPEN_GAP = {"gap": {"rule": "kinematic", "minimum_gap": 0.0, "time_gap": 0.0, "max_braking": 50.0}}


@dataclass
class Case:
    """A scenario, the actions of its agents, and what must occur in the case."""

    scenario: str
    overrides: dict
    num_steps: int = 200
    noise: float = 0.1
    bias: float = 0.0
    seed: int = 0
    meets: tuple = ("ENGAGED",)
    has_learner: bool = False
    pushing: float = 0.0
    policies: dict = field(default_factory=dict)
    num_roads: int = 1


CASES = {
    **{
        name: Case(name, {"observation": EVERY_FEATURE}, 120, num_roads=2)
        for name in list_scenarios()
    },
    "mixed": Case("paper", MIXED, 200, seed=1, meets=("COMPLETED",)),
    "settled changes": Case("paper", MIXED, 200, noise=0.0, seed=1, meets=("COMPLETED",)),
    "sum": Case("dense", {**MIXED, "drivers": {**MIXED["drivers"], "car_following": "sum"}}, 60),
    "acc": Case(
        "dense",
        {**MIXED, "drivers": {**MIXED["drivers"], "car_following": "acc", "coolness": 0.9}},
        120,
        meets=("WAITING", "ENGAGED", "COMPLETED"),
    ),
    "acc, crowded": Case(
        "paper",
        CROWDED | {"gap": {}, "drivers": {**MIXED["drivers"], "car_following": "acc"}},
        100,
        meets=("WAITING", "ENGAGED"),
    ),
    "kinematic": Case(
        "dense",
        {**MIXED, "gap": {"rule": "kinematic"}},
        150,
        meets=("WAITING", "ENGAGED", "COMPLETED"),
    ),
    "seeking": Case(
        "dense",
        {**MIXED, "followers": {"mix": {"adversarial": 1.0}}, "observation": STACKED},
        250,
        meets=("WAITING", "ABORTING", "COMPLETED"),
    ),
    "seeking, sum": Case(
        "paper",
        CROWDED | {"gap": {}, "drivers": {**MIXED["drivers"], "car_following": "sum"}},
        100,
        meets=("WAITING", "ENGAGED"),
    ),
    "gridded": Case(
        "paper",
        {**BUSY, "action": {"longitudinal": {}}, "observation": GRIDDED},
        60,
        noise=0.3,
        meets=("WAITING", "ENGAGED"),
    ),
    "busy": Case("paper", BUSY | {"observation": STACKED}, 100, meets=("WAITING", "ENGAGED")),
    "guard": Case(
        "paper",
        BUSY
        | {
            "followers": {"mix": {"adversarial": 1.0}},
            "road": {"num_lanes": 5, "length": 300.0},
            "gap": {"rule": "kinematic", "minimum_gap": 0.5, "time_gap": 0.1},
        },
        110,
        meets=("ABORTING", "COMPLETED", "MISSED"),
    ),
    "hostile": Case("paper", BUSY | OPEN_GAP, 150, bias=0.4, meets=("OFF_ROAD",)),
    "arcs": Case("paper", BUSY | {"road": {**BUSY["road"], "arcs": ARCS}}, 200, noise=0.3),
    "stepped arcs, every driver": Case(
        "interactive",
        CROWDED
        | LONGITUDINAL
        | {"road": {**CROWDED["road"], "arcs": STEPPED}, "drivers": MIXED["drivers"]}
        | {"followers": {"mix": {"learned": 1.0, "adversarial": 0.5, "cooperative": 0.5}}},
        150,
        pushing=2.0,
        has_learner=True,
        meets=("paired", "COMPLETED"),
    ),
    "coarse": Case(
        "paper",
        BUSY | OPEN_GAP | {"time_step": 0.25, "completion": {"max_yaw_rate": 0.05}},
        150,
        bias=0.4,
        meets=("COLLISION", "OFF_ROAD"),
    ),
    "through each other": Case(
        "paper",
        CROWDED
        | OPEN_GAP
        | {"time_step": 0.5, "lane_keeping": {"pole": 1.0}}
        | {"followers": {"mix": {"learned": 1.0}, "external": {**RECKLESS, "max_speed": 70.0}}},
        150,
        noise=0.5,
        pushing=9.0,
        has_learner=True,
        meets=("paired", "collision", "OFF_ROAD"),
    ),
    "full road": Case("paper", CROWDED | {"max_vehicles": 14}, 150, meets=("WAITING",)),
    "two actions": Case("paper", BUSY | LONGITUDINAL | PAID, 150, meets=("COMPLETED",)),
    "two actions, crowded": Case(
        "interactive",
        CROWDED | LONGITUDINAL | PAID | {"drivers": {"car_following": "sum"}},
        120,
        seed=2,
        meets=("WAITING", "ABORTING", "COMPLETED"),
    ),
    "delay": Case("dense", MIXED | PAID, 100, meets=("WAITING", "ENGAGED")),
    "learned": Case(
        "paper",
        CROWDED | {"followers": {"mix": {"learned": 1.0}}},
        150,
        pushing=2.0,
        has_learner=True,
        meets=("paired", "abort", "unpaired", "COMPLETED"),
    ),
    "learned, unguarded": Case(
        "paper",
        CROWDED
        | OPEN_GAP
        | {
            "followers": {
                "mix": {"learned": 1.0},
                "external": RECKLESS,
                "learned": {"objective": "cooperative"},
            }
        },
        150,
        noise=0.5,
        seed=1,
        pushing=3.0,
        has_learner=True,
        meets=("paired", "collision", "braking"),
    ),
    "external of several kinds": Case(
        "interactive",
        CROWDED
        | PAID
        | LONGITUDINAL
        | {"followers": {"mix": {"polite": 1.0, "adversarial": 0.5, "learned": 1.0, "rude": 1.0}}},
        220,
        seed=4,
        has_learner=True,
        policies={
            "polite": lambda seen: 0.2 * (seen[:, 2] - 10.0).clip(-10.0, 10.0),
            "rude": lambda seen: 0.05 * seen[:, 0].clip(0.0, 40.0),
        },
        meets=("paired", "abort", "scripted"),
    ),
    "moving over": Case(
        "yielding",
        BUSY
        | {
            "road": {"num_lanes": 6, "length": 600.0},
            "departures": {"interval": [1.0, 2.5], "initial_speed": [8.0, 20.0]},
            "command": {"probability": 1.0, "lanes": [1, 4]},
            "max_vehicles": 60,
            "num_slots": 8,
            "followers": {
                "mix": {"cooperative": 4.0, "neutral": 0.5, "adversarial": 0.5},
                "cooperative": {"moves_over": True},
            },
        },
        250,
        noise=0.0,
        seed=2,
        meets=("moving over", "moved over", "COMPLETED"),
    ),
    "short": Case(
        "paper",
        BUSY | {"horizon": 12.0, "warmup": [0.0, 0.0]},
        130,
        meets=("WAITING", "HORIZON"),
    ),
}


def follow(case):
    """Run the case and compare every step; returns the phases and outcomes that occurred."""
    simulator = Simulator(
        case.scenario,
        case.num_roads,
        seed=case.seed,
        overrides=case.overrides,
        learned_followers=case.has_learner,
        follower_policies=case.policies,
    )
    simulator.reset()
    generator = np.random.default_rng(case.seed)
    names = simulator.scenario.followers.external_names
    met = set()
    for _ in range(case.num_steps):
        roads = [Road.of(simulator, env) for env in range(case.num_roads)]
        moving = [moving_over(road) for road in roads]
        actions = damped_actions(simulator, case.noise, generator)
        actions[..., 0] += case.bias
        behind = generator.uniform(-7.0, 7.0, (*simulator.agents.shape, 1)) + case.pushing
        wanted = behind[..., 0].copy()
        for name, policy in case.policies.items():
            rows = simulator.state.followers["policy"] == names.index(name)
            wanted[rows] = policy(simulator.state.follower_observations[rows])
        simulator.step(actions, behind if case.has_learner else None)
        for env, road in enumerate(roads):
            road.step(actions[env].tolist(), wanted[env].tolist())
            compare_road(road, simulator, env)
            compare_vehicles(road, simulator, env)
            compare_agents(road, simulator, env)
            compare_followers(road, simulator, env)
            met |= set(met_by_agents(road))
            met |= set(met_behind(road))
            met |= set(met_beside(road, moving[env]))
    return met


@pytest.mark.parametrize(
    "name",
    [
        # The cases meet what the shipped scenarios do.
        pytest.param(name, marks=pytest.mark.slow if name in list_scenarios() else ())
        for name in CASES
    ],
)
def test_one_step_of_the_kernel_is_one_step_of_the_reference(name):
    met = follow(CASES[name])
    assert met.issuperset(CASES[name].meets), f"this case does not meet {CASES[name].meets}: {met}"


def test_a_move_that_is_taken_back_is_that_of_the_reference():
    fields = {"warmup": [0.0, 0.0], "observation": EVERY_FEATURE}
    simulator = Simulator("yielding", overrides=fields, seed=0)
    simulator.reset()
    stage(
        simulator,
        {"lane": 2, "position": 200.0, "disposition": Disposition.COOPERATIVE, "changer": 1},
        {"lane": 1, "position": 230.0},
        {"lane": 3, "position": 60.0},
    )
    command(simulator, 1, 1)
    met = set()
    for count in range(60):
        if count == 4:
            # A fast vehicle, close behind.
            other = simulator.vehicles[0, 2]
            other["position"], other["speed"] = simulator.vehicles[0, 0]["position"] - 6.0, 30.0
        road = Road.of(simulator)
        moving = moving_over(road)
        simulator.step()
        road.step(simulator.actions[0].tolist(), simulator.follower_actions[0, :, 0].tolist())
        compare_road(road, simulator, 0)
        compare_vehicles(road, simulator, 0)
        compare_agents(road, simulator, 0)
        met |= set(met_beside(road, moving))
    assert met == {"moving over", "took back"}
