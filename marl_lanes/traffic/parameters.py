"""A scenario's numbers in the form that kernels read: records of scalars, no Python objects."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from marl_lanes.scenario.dispositions import SCRIPTED
from marl_lanes.scenario.schema import Scenario
from marl_lanes.traffic.machine.state import Records, Table, structure
from marl_lanes.traffic.roles.changer import CHANGER
from marl_lanes.traffic.roles.follower import FOLLOWER
from marl_lanes.traffic.roles.role import Role

NO_BOUND = np.inf


def _kind(role: Role) -> str:
    """The dtype of one number for each term."""
    return f"({len(role.terms)},)f8"


CONSTANTS: Table = (
    ("time_step", "f8", "s", "dt"),
    ("road_length", "f8", "m", ""),
    ("lane_width", "f8", "m", ""),
    ("num_lanes", "i8", "1", "L"),
    ("longest_diagonal", "f8", "m", "of the bodies in the mix"),
    ("shortest_length", "f8", "m", "of the bodies in the mix"),
    ("narrowest_width", "f8", "m", "of the bodies in the mix"),
    ("max_braking", "f8", "m/s^2", "physical limit"),
    ("min_turning_radius", "f8", "m", ""),
    ("is_sum_form", "i8", "1", "1 for the standard IDM and the ACC model, 0 for Eq. 9"),
    ("is_acc", "i8", "1", "1 for the ACC model"),
    ("coolness", "f8", "1", "c of the ACC model"),
    ("interval_low", "f8", "s", "departures"),
    ("interval_high", "f8", "s", "departures"),
    ("initial_speed_low", "f8", "m/s", ""),
    ("initial_speed_high", "f8", "m/s", ""),
    ("warmup_low", "f8", "s", ""),
    ("warmup_high", "f8", "s", ""),
    ("keeping_pole", "f8", "rad/s", "lane keeping"),
    ("keeping_max_yaw_acceleration", "f8", "rad/s^2", "lane keeping"),
    ("command_low", "f8", "m", "command position"),
    ("command_high", "f8", "m", "command position"),
    ("command_probability", "f8", "1", ""),
    ("command_lanes", "i8", "1", "bit l set where vehicles of lane l are commanded"),
    ("time_limit_steps", "i8", "step", "from the command on, 0 for no limit"),
    ("num_agents", "i8", "1", "commands per episode, 0 for no limit"),
    ("horizon_steps", "i8", "step", "0 for no horizon"),
    ("is_gap_kinematic", "i8", "1", "1 for rule kinematic, 0 for car_following"),
    ("gap_safe_braking", "f8", "m/s^2", "b_safe of rule car_following"),
    ("gap_braking_margin", "f8", "m/s^2", "subtracted from b_safe to accept a gap"),
    ("gap_speed_factor", "f8", "1", "top speed for a gap divided by the desired speed"),
    ("gap_minimum", "f8", "m", "d_min of the gap rule"),
    ("gap_time", "f8", "s", "tau of rule kinematic"),
    ("gap_max_braking", "f8", "m/s^2", "b_max of rule kinematic"),
    ("cooperative_time_headway", "f8", "s", ""),
    ("cooperative_max_braking", "f8", "m/s^2", ""),
    ("is_moving_over_allowed", "i8", "1", "whether cooperative followers move over"),
    ("adversarial_speed_factor", "f8", "1", ""),
    ("adversarial_max_acceleration", "f8", "m/s^2", ""),
    ("adversarial_time_headway", "f8", "s", ""),
    ("external_max_acceleration", "f8", "m/s^2", "bound of an external driver's action"),
    ("external_max_braking", "f8", "m/s^2", "bound of an external driver's action"),
    ("external_max_speed", "f8", "m/s", ""),
    ("is_external_guarded", "i8", "1", ""),
    ("num_external", "i8", "1", "external dispositions of the mix"),
    ("follower_weights", _kind(FOLLOWER), "", "of the terms of a follower's reward"),
    ("follower_hard_braking", "f8", "m/s^2", "only harder braking costs reward"),
    ("completion_max_deviation", "f8", "m", ""),
    ("completion_max_lateral_speed", "f8", "m/s", "inf for no bound"),
    ("completion_max_yaw_rate", "f8", "rad/s", "inf for no bound"),
    ("max_yaw_acceleration", "f8", "rad/s^2", "bound of the action"),
    ("has_longitudinal", "i8", "1", "whether the action has a second dimension"),
    ("longitudinal_max_acceleration", "f8", "m/s^2", "bound of the second action"),
    ("longitudinal_max_braking", "f8", "m/s^2", "bound of the second action"),
    ("longitudinal_max_speed", "f8", "m/s", ""),
    ("sensor_range", "f8", "m", ""),
    ("num_stacked", "i8", "1", "observations that a changer sees"),
    ("grid_lanes", "i8", "1", "of the occupancy grid, 0 without one"),
    ("grid_stretches", "i8", "1", ""),
    ("grid_stretch", "f8", "m", "length of a stretch"),
    ("changer_weights", _kind(CHANGER), "", "of the terms of a changer's reward"),
    ("average_deviation", "f8", "m", "Eq. 12"),
)

PROFILE: Table = (
    ("share", "f8", "1", "cumulative share in the mix, the last is 1"),
    ("minimum_gap", "f8", "m", "s0"),
    ("time_headway", "f8", "s", "T"),
    ("max_acceleration", "f8", "m/s^2", "a_m"),
    ("comfortable_braking", "f8", "m/s^2", "b"),
    ("exponent", "f8", "1", "delta"),
    ("comfortable_lateral_acceleration", "f8", "m/s^2", "in a curve"),
    ("braking_scale", "f8", "m/s^2", "2 sqrt(a_m b)"),
    ("adversarial_braking_scale", "f8", "m/s^2", "the same with the adversarial a_m"),
    ("half_length", "f8", "m", "of the body, a rectangle about its centre"),
    ("half_width", "f8", "m", "of the body"),
    ("desired_speed_low", "f8", "m/s", "departures"),
    ("desired_speed_high", "f8", "m/s", "departures"),
)

_OF_VEHICLE = {"length", "width", "desired_speed"}
"""Fields of a profile that may be the scenario's."""

ARC: Table = (
    ("start", "f8", "m", ""),
    ("end", "f8", "m", ""),
    ("curvature", "f8", "1/m", "between its clothoids; positive bends left"),
    ("transition", "f8", "m", "length of the clothoid at each end"),
)


@dataclass(frozen=True)
class Parameters:
    """The constants of a scenario, in the order in which every kernel takes them."""

    constants: Records
    """(1,) CONSTANTS."""
    profiles: Records
    """(P,) PROFILE."""
    dispositions: NDArray[np.float64]
    """(3 + n,) cumulative shares of the scripted and the n external dispositions, the last is 1."""
    arcs: Records
    """(K,) ARC, ascending."""
    features: NDArray[np.int32]
    """(F,) codes of the features that a changer sees."""
    follower_features: NDArray[np.int32]
    """(G,) codes of the features that a follower sees."""

    @property
    def arrays(self) -> tuple[NDArray[np.generic], ...]:
        """The arrays in kernel order."""
        return (
            self.constants,
            self.profiles,
            self.dispositions,
            self.arcs,
            self.features,
            self.follower_features,
        )


def array_sizes(scenario: Scenario) -> dict[str, int]:
    """The sizes of a road's arrays, as ``allocate`` takes them."""
    return {
        "num_lanes": scenario.road.num_lanes,
        "max_vehicles": scenario.max_vehicles,
        "num_slots": scenario.num_slots,
        "num_features": len(CHANGER.seen(scenario)),
        "num_terms": len(CHANGER.terms),
        "num_follower_features": len(FOLLOWER.seen(scenario)),
        "num_follower_terms": len(FOLLOWER.terms),
    }


def make_parameters(scenario: Scenario) -> Parameters:
    """The numbers of ``scenario`` for the kernels."""
    profiles = np.zeros(len(scenario.drivers.profiles), structure(PROFILE))
    shares = [scenario.drivers.mix.get(name, 0.0) for name in scenario.drivers.profiles]
    profiles["share"] = _cumulative(shares)
    for row, (name, profile) in zip(profiles, scenario.drivers.profiles.items(), strict=True):
        for field, value in profile.model_dump(exclude=_OF_VEHICLE).items():
            row[field] = value
        length, width = scenario.body_of(name)
        row["half_length"], row["half_width"] = 0.5 * length, 0.5 * width
        row["desired_speed_low"], row["desired_speed_high"] = scenario.desired_speed_of(name)
        braking = profile.comfortable_braking
        adversarial = scenario.followers.adversarial.max_acceleration
        row["braking_scale"] = 2.0 * math.sqrt(profile.max_acceleration * braking)
        row["adversarial_braking_scale"] = 2.0 * math.sqrt(adversarial * braking)
    mix = scenario.followers.mix
    names = (*SCRIPTED, *scenario.followers.external_names)
    arcs = np.zeros(len(scenario.road.arcs), structure(ARC))
    for row, arc in zip(arcs, scenario.road.arcs, strict=True):
        row["start"], row["end"], row["curvature"] = arc.start, arc.end, 1.0 / arc.radius
        row["transition"] = arc.transition
    return Parameters(
        constants=_make_constants(scenario),
        profiles=profiles,
        dispositions=_cumulative([mix.get(name, 0.0) for name in names]),
        arcs=arcs,
        features=CHANGER.codes(scenario),
        follower_features=FOLLOWER.codes(scenario),
    )


def _cumulative(shares: list[float]) -> NDArray[np.float64]:
    cumulative = np.cumsum(np.asarray(shares, np.float64))
    return np.asarray(cumulative / cumulative[-1])


def _make_constants(scenario: Scenario) -> Records:
    completion, departures = scenario.completion, scenario.departures
    external, names = scenario.followers.external, scenario.followers.external_names
    longitudinal, grid = scenario.action.longitudinal, scenario.observation.grid
    bodies = [scenario.body_of(name) for name in scenario.drivers.driven]
    values: dict[str, float | list[float]] = {
        "time_step": scenario.time_step,
        "road_length": scenario.road.length,
        "lane_width": scenario.road.lane_width,
        "num_lanes": scenario.road.num_lanes,
        "longest_diagonal": max(math.sqrt(x * x + y * y) for x, y in bodies),
        "shortest_length": min(length for length, _ in bodies),
        "narrowest_width": min(width for _, width in bodies),
        "max_braking": scenario.vehicle.max_braking,
        "min_turning_radius": scenario.vehicle.min_turning_radius,
        "is_sum_form": scenario.drivers.car_following != "max",
        "is_acc": scenario.drivers.car_following == "acc",
        "coolness": scenario.drivers.coolness,
        "interval_low": departures.interval[0],
        "interval_high": departures.interval[1],
        "initial_speed_low": departures.initial_speed[0],
        "initial_speed_high": departures.initial_speed[1],
        "warmup_low": scenario.warmup[0],
        "warmup_high": scenario.warmup[1],
        "keeping_pole": scenario.lane_keeping.pole,
        "keeping_max_yaw_acceleration": scenario.lane_keeping.max_yaw_acceleration,
        "command_low": scenario.command.position[0],
        "command_high": scenario.command.position[1],
        "command_probability": scenario.command.probability,
        "command_lanes": sum(1 << lane for lane in scenario.command_lanes),
        "time_limit_steps": round((scenario.command.time_limit or 0.0) / scenario.time_step),
        "num_agents": scenario.num_agents or 0,
        "horizon_steps": round((scenario.horizon or 0.0) / scenario.time_step),
        "is_gap_kinematic": scenario.gap.rule == "kinematic",
        "gap_safe_braking": scenario.gap.safe_braking,
        "gap_braking_margin": scenario.gap.braking_margin,
        "gap_speed_factor": scenario.gap.speed_factor,
        "gap_minimum": scenario.gap.minimum_gap,
        "gap_time": scenario.gap.time_gap,
        "gap_max_braking": scenario.gap.max_braking,
        "cooperative_time_headway": scenario.followers.cooperative.time_headway,
        "cooperative_max_braking": scenario.followers.cooperative.max_braking,
        "is_moving_over_allowed": scenario.followers.cooperative.moves_over,
        "adversarial_speed_factor": scenario.followers.adversarial.desired_speed_factor,
        "adversarial_max_acceleration": scenario.followers.adversarial.max_acceleration,
        "adversarial_time_headway": scenario.followers.adversarial.time_headway,
        "external_max_acceleration": external.max_acceleration,
        "external_max_braking": external.max_braking,
        "external_max_speed": external.max_speed,
        "is_external_guarded": external.is_guarded,
        "num_external": len(names),
        "follower_weights": FOLLOWER.weights(scenario),
        "follower_hard_braking": scenario.followers.learned.reward.hard_braking,
        "completion_max_deviation": completion.max_deviation,
        "completion_max_lateral_speed": completion.max_lateral_speed or NO_BOUND,
        "completion_max_yaw_rate": completion.max_yaw_rate or NO_BOUND,
        "max_yaw_acceleration": scenario.action.max_yaw_acceleration,
        "has_longitudinal": longitudinal is not None,
        "longitudinal_max_acceleration": longitudinal.max_acceleration if longitudinal else 0.0,
        "longitudinal_max_braking": longitudinal.max_braking if longitudinal else 0.0,
        "longitudinal_max_speed": longitudinal.max_speed if longitudinal else 0.0,
        "sensor_range": scenario.observation.sensor_range,
        "num_stacked": scenario.observation.num_stacked,
        "grid_lanes": grid.num_lanes if grid else 0,
        "grid_stretches": grid.num_stretches if grid else 0,
        "grid_stretch": grid.stretch if grid else 0.0,
        "changer_weights": CHANGER.weights(scenario),
        "average_deviation": scenario.reward.average_deviation,
    }
    constants = np.zeros(1, structure(CONSTANTS))
    for name, _, _, _ in CONSTANTS:
        constants[0][name] = values[name]
    return constants
