"""The scenario's fields: units, limits and defaults.

The defaults are the paper's values, so a YAML file has only the fields that differ. Units are SI; a
speed may be written as ``30 km/h``.
"""

from typing import Literal, Self

from pydantic import Field, model_validator

from marl_lanes.scenario.agent import Action, Completion, Observation, Reward
from marl_lanes.scenario.curves import deviation_in_curves
from marl_lanes.scenario.drivers import Drivers
from marl_lanes.scenario.fields import (
    Count,
    Interval,
    Name,
    NonNegative,
    Position,
    Positive,
    Range,
    Section,
    Speed,
    WarmUp,
)
from marl_lanes.scenario.followers import Followers
from marl_lanes.scenario.messages import shown
from marl_lanes.scenario.road import Road, Vehicle

MIN_KEEPING_SHARE = 0.14
"""[rad/s] Least bound of lane keeping's yaw acceleration, of its pole."""

MAX_KEEPING_STEP = 0.5
"""[1] Largest pole of lane keeping times time step."""

MAX_CARRIED_SHARE = 0.8
"""[1] How far a curve may carry a vehicle off its lane's centre, of the room beside its body."""


class Departures(Section):
    """How vehicles enter each lane."""

    interval: Range[Interval] = Field(
        (5.0, 10.0), description="time between two departures of a lane [s], 0.1 to 1e6, uniform"
    )
    initial_speed: Range[Speed] = Field(
        (30.0 / 3.6, 50.0 / 3.6),
        description="speed at entry [m/s or 'x km/h'], 0.1 to 70 m/s, uniform",
    )
    desired_speed: Range[Speed] = Field(
        (80.0 / 3.6, 120.0 / 3.6),
        description="v0, a driver's speed on a free road [m/s or 'x km/h'], 0.1 to 70 m/s, uniform",
    )


class LaneKeeping(Section):
    """Steering of every vehicle that no agent steers: three equal poles on the lane's centre."""

    pole: Positive = Field(
        2.0, ge=0.01, le=3.0, description="closed-loop pole [rad/s], 0.01 to 3, <= 0.5/time_step"
    )
    max_yaw_acceleration: Positive = Field(
        0.5,
        ge=0.001,
        le=5.0,
        description="largest yaw acceleration of lane keeping [rad/s^2], 0.001 to 5, >= 0.14 pole",
    )


class Command(Section):
    """Which vehicles get a lane-change command, when, and for how long."""

    position: Range[Position] = Field(
        (140.0, 160.0),
        description="position at which a vehicle may be commanded [m], 0 to 100,000, "
        "< road.length, uniform",
    )
    probability: NonNegative = Field(
        1.0 / 3.0, le=1.0, description="share of the vehicles commanded [1], 0 to 1"
    )
    lanes: tuple[Count, ...] | None = Field(
        None,
        max_length=16,
        description="lanes whose vehicles are commanded [list of lanes], null for those with a "
        "lane on both sides, or for both of two; from an outer lane the change is to the only side",
    )
    time_limit: Positive | None = Field(
        None,
        ge=0.01,
        le=1e6,
        description="time for a change [s], from its command on, then the agent's life ends as "
        "timed_out; time_step to 1e6, null for no limit",
    )


class Gap(Section):
    """The gap rule: which gaps the rear vehicle can follow without hard braking."""

    rule: Literal["car_following", "kinematic"] = Field(
        "car_following",
        description="rule for a safe gap [name]: 'car_following' if the driver's own law brakes "
        "at most safe_braking, 'kinematic' if gap >= minimum_gap + time_gap v_rear + "
        "max(0, dv)^2/(2 max_braking)",
    )
    safe_braking: Positive = Field(
        4.0,
        ge=0.01,
        le=100.0,
        description="b_safe of rule car_following: harder braking aborts [m/s^2], 0.01 to 100",
    )
    braking_margin: NonNegative = Field(
        1.0,
        le=100.0,
        description="to accept a gap, braking must be milder than safe_braking by this [m/s^2], "
        "0 to 100, < safe_braking",
    )
    speed_factor: Positive = Field(
        1.1,
        ge=1.0,
        le=2.0,
        description="a driver may exceed its desired speed by this factor to reach a gap [1], "
        "1 to 2",
    )
    minimum_gap: NonNegative = Field(
        2.0, le=10_000.0, description="d_min of both rules and of the guard [m], 0 to 10,000"
    )
    time_gap: NonNegative = Field(
        0.4, le=60.0, description="tau of rule kinematic and of the guard [s], 0 to 60"
    )
    max_braking: Positive = Field(
        4.0,
        ge=0.01,
        le=1000.0,
        description="b_max, braking of the vehicle behind, of rule kinematic and of the guard "
        "[m/s^2], 0.01 to 1000",
    )

    @model_validator(mode="after")
    def _check_margin(self) -> Self:
        if self.braking_margin >= self.safe_braking:
            raise ValueError(
                f"braking_margin = {self.braking_margin} must be below "
                f"safe_braking = {self.safe_braking}"
            )
        return self


class Scenario(Section):
    """A road, its traffic, the commands, the agents' action, observation and reward."""

    name: Name = Field(description="the scenario's name [text], 1 to 255 characters")
    description: str = Field(
        "",
        max_length=1000,
        description="one sentence about its purpose [text], up to 1000 characters",
    )
    time_step: Positive = Field(0.1, ge=0.01, le=0.5, description="dt [s], 0.01 to 0.5")
    num_agents: Count | None = Field(
        10,
        ge=1,
        le=100_000,
        description="commands per episode [count], 1 to 100,000, null for no limit",
    )
    horizon: Positive | None = Field(
        1800.0,
        ge=0.01,
        le=1e6,
        description="longest episode after the warm-up [s], time_step to 1e6, null for no limit",
    )
    num_slots: Count = Field(
        8, ge=1, le=64, description="largest number of live agents [count], 1 to 64"
    )
    max_vehicles: Count = Field(
        64, ge=4, le=4096, description="largest number of vehicles on the road [count], 4 to 4,096"
    )
    warmup: Range[WarmUp] = Field(
        (60.0, 90.0),
        description="simulated traffic before an episode starts [s], 0 to 3600, uniform",
    )
    road: Road = Field(default=Road(), description="geometry [section]")
    vehicle: Vehicle = Field(default=Vehicle(), description="body and limits [section]")
    drivers: Drivers = Field(default=Drivers(), description="car following [section]")
    departures: Departures = Field(default=Departures(), description="inflow [section]")
    lane_keeping: LaneKeeping = Field(default=LaneKeeping(), description="steering [section]")
    command: Command = Field(default=Command(), description="lane-change commands [section]")
    gap: Gap = Field(default=Gap(), description="gap rule [section]")
    followers: Followers = Field(default=Followers(), description="dispositions [section]")
    completion: Completion = Field(default=Completion(), description="end of a change [section]")
    action: Action = Field(default=Action(), description="bounds of the action [section]")
    observation: Observation = Field(default=Observation(), description="features [section]")
    reward: Reward = Field(default=Reward(), description="weights of the terms [section]")

    @property
    def command_lanes(self) -> tuple[int, ...]:
        """Lanes whose vehicles may be commanded."""
        if self.command.lanes is not None:
            return self.command.lanes
        lanes = tuple(range(self.road.num_lanes))
        return lanes[1:-1] or lanes

    def body_of(self, profile: str) -> tuple[float, float]:
        """Length and width of the vehicles with this driver profile [m]."""
        driver = self.drivers.profiles[profile]
        return (
            self.vehicle.length if driver.length is None else driver.length,
            self.vehicle.width if driver.width is None else driver.width,
        )

    def desired_speed_of(self, profile: str) -> tuple[float, float]:
        """Range of v0 with this driver profile [m/s]."""
        return self.drivers.profiles[profile].desired_speed or self.departures.desired_speed

    @model_validator(mode="after")
    def _check_together(self) -> Self:
        self._check_widths()
        if self.command.position[1] >= self.road.length:
            raise ValueError(
                f"command.position = {list(self.command.position)} must be below road.length = "
                f"{self.road.length}"
            )
        last_lane = self.road.num_lanes - 1
        missing = [lane for lane in self.command_lanes if not 0 <= lane <= last_lane]
        if missing:
            raise ValueError(
                f"command.lanes = {shown(missing)} must be from 0 to {last_lane}, as "
                f"road.num_lanes = {self.road.num_lanes}"
            )
        if self.command.probability > 0.0 and not self.command_lanes:
            raise ValueError(
                f"command.probability = {self.command.probability} must be 0, as "
                "command.lanes = [] names no lane"
            )
        if len(set(self.command_lanes)) < len(self.command_lanes):
            raise ValueError(
                f"command.lanes = {list(self.command_lanes)} must not name a lane twice"
            )
        if self.horizon is not None and self.horizon < self.time_step:
            raise ValueError(
                f"horizon = {self.horizon} must be at least time_step = {self.time_step}"
            )
        limit = self.command.time_limit
        if limit is not None and limit < self.time_step:
            raise ValueError(
                f"command.time_limit = {limit} must be at least time_step = {self.time_step}"
            )
        if self.lane_keeping.pole * self.time_step > MAX_KEEPING_STEP:
            raise ValueError(
                f"lane_keeping.pole = {self.lane_keeping.pole} must be at most "
                f"{MAX_KEEPING_STEP}/time_step = {MAX_KEEPING_STEP / self.time_step:.4g}: beyond "
                "that lane keeping is unstable"
            )
        least = MIN_KEEPING_SHARE * self.lane_keeping.pole
        if self.lane_keeping.max_yaw_acceleration < least:
            raise ValueError(
                f"lane_keeping.max_yaw_acceleration = {self.lane_keeping.max_yaw_acceleration} "
                f"must be at least {MIN_KEEPING_SHARE} pole = {least:.4g}: below that "
                "lane keeping saturates and is unstable"
            )
        self._check_curves()
        if self.completion.max_deviation >= self.road.lane_width / 2.0:
            raise ValueError(
                f"completion.max_deviation = {self.completion.max_deviation} must be below half "
                f"of road.lane_width = {self.road.lane_width}"
            )
        return self

    def _check_widths(self) -> None:
        """Reject bodies that are as wide as a lane."""
        widths = {"vehicle.width": self.vehicle.width} | {
            f"drivers.profiles.{name}.width": self.body_of(name)[1] for name in self.drivers.driven
        }
        for field, width in widths.items():
            if width >= self.road.lane_width:
                raise ValueError(
                    f"{field} = {width} must be below road.lane_width = {self.road.lane_width}"
                )

    def _check_curves(self) -> None:
        """Reject curves in which lane keeping would leave its lane."""
        speeds = [self.departures.initial_speed[1], self.followers.external.max_speed]
        # Both factors apply to an adversarial driver that seeks a gap itself.
        factors = self.followers.adversarial.desired_speed_factor * self.gap.speed_factor
        if self.action.longitudinal is not None:
            speeds.append(self.action.longitudinal.max_speed)
        for name in self.drivers.driven:
            lateral = self.drivers.profiles[name].comfortable_lateral_acceleration
            room = MAX_CARRIED_SHARE * (self.road.lane_width - self.body_of(name)[1]) / 2.0
            deviations = deviation_in_curves(
                self.road.arcs,
                road_width=self.road.num_lanes * self.road.lane_width,
                lateral_acceleration=lateral,
                top_speed=max(*speeds, self.desired_speed_of(name)[1] * factors),
                pole=self.lane_keeping.pole,
                max_yaw_acceleration=self.lane_keeping.max_yaw_acceleration,
            )
            for arc, deviation in zip(self.road.arcs, deviations, strict=True):
                if deviation > room:
                    raise ValueError(
                        f"road.arcs: radius = {arc.radius} from {arc.start} with transition = "
                        f"{arc.transition}: lane keeping must stay within {room:.3g} m of the "
                        f"lane's centre, but deviates by {deviation:.3g} m with the driver profile "
                        f"{name!r} of comfortable_lateral_acceleration = {lateral}; use a longer "
                        "transition, a larger radius, a smaller lateral acceleration or a larger "
                        "lane_keeping.pole"
                    )
