"""Dispositions: how the vehicle behind an engaged changer in its target lane behaves."""

from typing import Annotated, Literal

from pydantic import AfterValidator, Field

from marl_lanes.scenario.dispositions import SCRIPTED
from marl_lanes.scenario.fields import (
    Line,
    NonNegative,
    Positive,
    Real,
    Section,
    Share,
    Weight,
    has_weight,
)

DispositionName = Annotated[str, Field(pattern=r"^[A-Za-z_][A-Za-z0-9_-]*$", max_length=64)]


class Cooperative(Section):
    """A follower whose leader is also the changer, from the engagement on."""

    time_headway: Positive = Field(
        1.5, ge=0.01, le=60.0, description="T toward the changer [s], 0.01 to 60"
    )
    max_braking: Positive = Field(
        2.0,
        ge=0.01,
        le=12.0,
        description="hardest braking for a changer whose body is not in the lane yet [m/s^2], "
        "0.01 to 12",
    )
    moves_over: bool = Field(
        False, description="whether it may also yield by moving to the lane beyond [bool]"
    )


class Adversarial(Section):
    """A follower that closes the gap until the changer's body is in its lane."""

    desired_speed_factor: Positive = Field(
        1.3, ge=1.0, le=2.0, description="multiplies its desired speed [1], 1 to 2"
    )
    max_acceleration: Positive = Field(
        3.0, ge=0.01, le=10.0, description="a_m while it closes the gap [m/s^2], 0.01 to 10"
    )
    time_headway: Positive = Field(
        0.5, ge=0.01, le=60.0, description="T while it closes the gap [s], 0.01 to 60"
    )


class External(Section):
    """The limits of a follower that a registered policy, a checkpoint or a learner drives."""

    max_acceleration: Positive = Field(
        3.0, ge=0.01, le=10.0, description="largest acceleration [m/s^2], 0.01 to 10"
    )
    max_braking: Positive = Field(
        3.0, ge=0.01, le=12.0, description="hardest braking that it may choose [m/s^2], 0.01 to 12"
    )
    max_speed: Positive = Field(
        40.0, ge=0.1, le=70.0, description="it accelerates up to this speed [m/s], 0.1 to 70"
    )
    is_guarded: bool = Field(
        True,
        description="whether car following with the gap rule's parameters limits the action [bool]",
    )


class FollowerReward(Section):
    """The weights of a learned follower's reward; a negative weight changes a term's sign."""

    delay_weight: Real = Field(
        ge=-1e6,
        le=1e6,
        description="weight of each second in which the changer's body is not in the lane yet "
        "[1/s], -1e6 to 1e6",
    )
    abort_weight: Real = Field(
        ge=-1e6, le=1e6, description="weight of each abort of the changer [1], -1e6 to 1e6"
    )
    collision_penalty: Weight = Field(
        description="cost of a collision of the follower [1], 0 to 1e6"
    )
    discomfort_weight: Weight = Field(
        description="weight of the square of its acceleration [s^4/m^2], 0 to 1e6"
    )
    braking_weight: Weight = Field(
        description="weight of its braking beyond hard_braking [s^2/m], 0 to 1e6"
    )
    hard_braking: NonNegative = Field(
        3.0, le=12.0, description="harder braking has a cost [m/s^2], 0 to 12"
    )


class Learned(Section):
    """The disposition ``learned``: its policy and its reward."""

    checkpoint: Annotated[Line, Field(min_length=1, max_length=4096)] | None = Field(
        None,
        description="file of a follower's policy [path], or zoo:NAME, null if a learner drives; in "
        "a scenario file the path begins at the file's folder and stays in it",
    )
    objective: Literal["adversarial", "cooperative"] = Field(
        "adversarial", description="which of the two rewards a learner gets [name]"
    )
    adversarial: FollowerReward = Field(
        default=FollowerReward(
            delay_weight=0.1,
            abort_weight=1.0,
            collision_penalty=10.0,
            discomfort_weight=0.001,
            braking_weight=0.02,
        ),
        description="reward for delays and aborts [section]",
    )
    cooperative: FollowerReward = Field(
        default=FollowerReward(
            delay_weight=-0.1,
            abort_weight=-1.0,
            collision_penalty=10.0,
            discomfort_weight=0.01,
            braking_weight=0.02,
        ),
        description="reward for changes without delay or abort [section]",
    )

    @property
    def reward(self) -> FollowerReward:
        """The weights of the objective."""
        return self.adversarial if self.objective == "adversarial" else self.cooperative


class Followers(Section):
    """The dispositions' shares and parameters."""

    mix: Annotated[dict[DispositionName, Share], AfterValidator(has_weight)] = Field(
        default={"neutral": 1.0},
        max_length=64,
        description="share of each disposition [1]: cooperative, neutral, adversarial, learned, or "
        "a registered name; 0 to 1e6, not all 0",
    )
    cooperative: Cooperative = Field(
        default=Cooperative(), description="parameters of cooperative followers [section]"
    )
    adversarial: Adversarial = Field(
        default=Adversarial(), description="parameters of adversarial followers [section]"
    )
    external: External = Field(
        default=External(), description="limits of learned and registered followers [section]"
    )
    learned: Learned = Field(
        default=Learned(), description="policy and reward of learned followers [section]"
    )

    @property
    def external_names(self) -> tuple[str, ...]:
        """The names in the mix that are not scripted, in the order of the mix."""
        return tuple(name for name in self.mix if name not in SCRIPTED)
