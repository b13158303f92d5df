"""The drivers: car-following law and profiles."""

from typing import Annotated, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from marl_lanes.scenario.fields import (
    Length,
    Name,
    NonNegative,
    Positive,
    Range,
    Section,
    Share,
    Speed,
    Width,
    has_weight,
)
from marl_lanes.scenario.messages import shown


class DriverProfile(Section):
    """An IDM parameter set (Eq. 9), the lateral acceleration in curves, and the vehicle.

    What is null is as for every vehicle of the scenario.
    """

    minimum_gap: Positive = Field(
        5.0, ge=0.01, le=1000.0, description="s0, gap at standstill [m], 0.01 to 1000"
    )
    time_headway: Positive = Field(
        1.0, ge=0.01, le=60.0, description="T, time gap to the leader [s], 0.01 to 60"
    )
    max_acceleration: Positive = Field(2.0, ge=0.01, le=10.0, description="a_m [m/s^2], 0.01 to 10")
    comfortable_braking: Positive = Field(
        1.5, ge=0.01, le=12.0, description="b [m/s^2], 0.01 to 12"
    )
    exponent: Positive = Field(4.0, ge=1.0, le=20.0, description="delta [1], 1 to 20")
    comfortable_lateral_acceleration: Positive = Field(
        2.0, ge=0.2, le=4.0, description="largest v^2 |curvature| in a curve [m/s^2], 0.2 to 4"
    )
    length: Length | None = Field(None, description="[m], 2 to 20, null for vehicle.length")
    width: Width | None = Field(
        None, description="[m], 0.5 to 2.6, < road.lane_width, null for vehicle.width"
    )
    desired_speed: Range[Speed] | None = Field(
        None,
        description="v0 [m/s or 'x km/h'], 0.1 to 70 m/s, uniform, null for "
        "departures.desired_speed",
    )


def _default_profiles() -> dict[str, DriverProfile]:
    return {
        "normal": DriverProfile(),
        "aggressive": DriverProfile(
            minimum_gap=3.0,
            time_headway=0.6,
            max_acceleration=3.0,
            comfortable_braking=2.5,
            comfortable_lateral_acceleration=3.0,
        ),
        "defensive": DriverProfile(
            minimum_gap=6.0,
            time_headway=1.6,
            max_acceleration=1.4,
            comfortable_braking=1.2,
            comfortable_lateral_acceleration=1.5,
        ),
        # Size: the largest articulated vehicle of Directive 96/53/EC. Speed: from Germany's limit
        # for trucks to the limiter of Directive 92/6/EEC. s0, T, a_m, b: traffic-simulation.de.
        "truck": DriverProfile(
            minimum_gap=2.0,
            time_headway=2.0,
            max_acceleration=0.6,
            comfortable_braking=2.0,
            comfortable_lateral_acceleration=1.5,
            length=16.5,
            width=2.55,
            desired_speed=(80.0 / 3.6, 90.0 / 3.6),
        ),
    }


class Drivers(Section):
    """The drivers: car-following law and mix of profiles."""

    car_following: Literal["max", "sum", "acc"] = Field(
        "max",
        description="law [name]: 'max' is the paper's Eq. 9, 'sum' the standard IDM, 'acc' the "
        "ACC model on top of it",
    )
    coolness: NonNegative = Field(
        0.99, le=1.0, description="c of the ACC model [1], 0 (the standard IDM) to 1"
    )
    profiles: dict[Name, DriverProfile] = Field(
        default_factory=_default_profiles,
        min_length=1,
        max_length=16,
        description="IDM parameter sets by name [map], 1 to 16",
    )
    mix: Annotated[dict[Name, Share], AfterValidator(has_weight)] = Field(
        default={"normal": 1.0},
        max_length=16,
        description="share of each profile [1], 0 to 1e6, names from profiles, not all 0",
    )

    @property
    def driven(self) -> list[str]:
        """The profiles that vehicles have: those with a share in the mix."""
        return [name for name in self.profiles if self.mix.get(name, 0.0) > 0.0]

    @model_validator(mode="after")
    def _check_mix(self) -> Self:
        unknown = sorted(set(self.mix) - set(self.profiles))
        if unknown:
            raise ValueError(
                f"mix: {shown(unknown)} must be among the profiles {sorted(self.profiles)}"
            )
        return self
