"""What the vehicle behind an engaged changer in its target lane does."""

from typing import Annotated, Literal

from pydantic import AfterValidator, Field

from marl_lanes.scenario.fields import NonNegative, Positive, Real, Section, Share, has_weight

SCRIPTED = ("cooperative", "neutral", "adversarial")
"""The dispositions that the simulation itself drives, in the order of their codes."""

LEARNED = "learned"
"""The disposition that a checkpoint or a learner drives."""

DispositionName = Annotated[str, Field(pattern=r"^[A-Za-z_][A-Za-z0-9_-]*$", max_length=64)]


class Cooperative(Section):
    """A follower that takes the engaged changer as its leader from engagement on."""

    time_headway: Positive = Field(1.5, description="T toward the changer [s], > 0")
    max_braking: Positive = Field(
        2.0, description="hardest braking for a changer not yet in its lane [m/s^2], > 0"
    )
    moves_over: bool = Field(
        False, description="whether it may also move to the lane beyond to yield [bool]"
    )


class Adversarial(Section):
    """A follower that closes the gap until the changer's body is in its lane."""

    desired_speed_factor: Positive = Field(
        1.3, ge=1.0, le=2.0, description="on its desired speed [1], 1 to 2"
    )
    max_acceleration: Positive = Field(
        3.0, le=10.0, description="a_m while it closes the gap [m/s^2], > 0 to 10"
    )
    time_headway: Positive = Field(0.5, description="T while it closes the gap [s], > 0")


class External(Section):
    """The limits of a follower that a registered policy, a checkpoint or a learner drives."""

    max_acceleration: Positive = Field(
        3.0, le=10.0, description="upper bound of its action [m/s^2], > 0 to 10"
    )
    max_braking: Positive = Field(
        3.0, le=12.0, description="lower bound of its action, as a braking [m/s^2], > 0 to 12"
    )
    max_speed: Positive = Field(
        40.0, le=70.0, description="it accelerates up to this speed [m/s], > 0 to 70"
    )
    is_guarded: bool = Field(
        True, description="whether car following with the gap rule's numbers bounds it [bool]"
    )


class FollowerReward(Section):
    """The weights of a learned follower's reward; a negative weight turns a term round."""

    delay_weight: Real = Field(
        description="for each second in which the changer is not yet in its lane [1/s]"
    )
    abort_weight: Real = Field(description="for each abort of the changer [1]")
    collision_penalty: NonNegative = Field(description="paid once when it collides [1], >= 0")
    discomfort_weight: NonNegative = Field(
        description="on the square of its acceleration [s^4/m^2], >= 0"
    )
    braking_weight: NonNegative = Field(
        description="on its braking beyond hard_braking [s^2/m], >= 0"
    )
    hard_braking: NonNegative = Field(3.0, description="braking beyond it is hard [m/s^2], >= 0")


class Learned(Section):
    """The disposition ``learned``: whose policy it is, and what it learns for."""

    checkpoint: Annotated[str, Field(min_length=1)] | None = Field(
        None, description="file of a follower's policy [path], null where a learner drives"
    )
    objective: Literal["adversarial", "cooperative"] = Field(
        "adversarial", description="which of the two rewards a learner is paid [name]"
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
        description="share of each disposition [1]: cooperative, neutral, adversarial, learned, or "
        "a registered name; 0 to 1e6, not all 0",
    )
    cooperative: Cooperative = Field(
        default=Cooperative(), description="parameters of the cooperative ones [section]"
    )
    adversarial: Adversarial = Field(
        default=Adversarial(), description="parameters of the adversarial ones [section]"
    )
    external: External = Field(
        default=External(), description="limits of learned and registered ones [section]"
    )
    learned: Learned = Field(
        default=Learned(), description="policy and reward of the learned ones [section]"
    )

    @property
    def external_names(self) -> tuple[str, ...]:
        """The names in the mix that the simulation itself does not drive, in its order."""
        return tuple(name for name in self.mix if name not in SCRIPTED)
