"""The road and the vehicles on it."""

from itertools import pairwise
from typing import Self

from pydantic import Field, model_validator

from marl_lanes.scenario.curves import Arc
from marl_lanes.scenario.fields import Count, Length, Positive, Section, Width


class Road(Section):
    """One direction of a highway; lane 0 is the right-most, positive lateral is left."""

    length: Positive = Field(1000.0, ge=100.0, le=100_000.0, description="[m], 100 to 100,000")
    num_lanes: Count = Field(3, ge=2, le=16, description="lanes [count], 2 to 16")
    lane_width: Positive = Field(3.75, ge=2.5, le=6.0, description="[m], 2.5 to 6")
    arcs: tuple[Arc, ...] = Field(
        (),
        max_length=1000,
        description="curves [list], at most 1000, ascending, disjoint; the road is straight "
        "elsewhere",
    )

    @model_validator(mode="after")
    def _check_arcs(self) -> Self:
        for arc in self.arcs:
            if not arc.start < arc.end <= self.length:
                raise ValueError(
                    f"arcs: start {arc.start} and end {arc.end} must satisfy "
                    f"0 <= start < end <= length = {self.length}"
                )
            if abs(arc.radius) < max(50.0, 2.0 * self.num_lanes * self.lane_width):
                raise ValueError(
                    f"arcs: |radius| = {abs(arc.radius)} must be at least 50 m and twice "
                    "the road's width"
                )
            if 2.0 * arc.transition > arc.end - arc.start:
                raise ValueError(
                    f"arcs: transition = {arc.transition} of the arc from {arc.start} to {arc.end} "
                    f"must be at most half of its length, {(arc.end - arc.start) / 2.0}"
                )
        for first, second in pairwise(self.arcs):
            if first.end > second.start:
                raise ValueError(
                    f"arcs: the arc that starts at {second.start} must not start before the "
                    f"one ahead of it ends at {first.end}"
                )
        return self


class Vehicle(Section):
    """The body of a vehicle, a rectangle, and its physical limits.

    A driver profile may have another length and width.
    """

    length: Length = Field(4.8, description="[m], 2 to 20")
    width: Width = Field(1.8, description="[m], 0.5 to 2.6, < road.lane_width")
    max_braking: Positive = Field(
        8.0, ge=2.0, le=12.0, description="physical braking limit [m/s^2], 2 to 12"
    )
    min_turning_radius: Positive = Field(
        5.5, ge=1.0, le=20.0, description="limits |yaw rate| to speed/radius [m], 1 to 20"
    )
