"""Action, observation and reward of an agent, and when its lane change is complete."""

from typing import Literal, Self, get_args

from pydantic import Field, model_validator

from marl_lanes.scenario.fields import Count, Positive, Section, Weight


class Completion(Section):
    """When a changer has settled in a lane: all bounds hold that are not null.

    In the target lane the change is then complete. In the origin lane, after an abort, the changer
    waits again.
    """

    max_deviation: Positive = Field(
        0.2, ge=0.001, le=3.0, description="|lateral deviation| [m], 0.001 to 3"
    )
    max_lateral_speed: Positive | None = Field(
        0.25,
        ge=0.001,
        le=100.0,
        description="|lateral speed| [m/s], 0.001 to 100, null for no bound",
    )
    max_yaw_rate: Positive | None = Field(
        0.03,
        ge=0.001,
        le=100.0,
        description="|yaw rate - the road's turning| [rad/s], 0.001 to 100, null for no bound",
    )


class Longitudinal(Section):
    """The second dimension of the action: the longitudinal acceleration of a live agent."""

    max_acceleration: Positive = Field(
        2.0, ge=0.01, le=10.0, description="largest acceleration [m/s^2], 0.01 to 10"
    )
    max_braking: Positive = Field(
        3.0, ge=0.01, le=12.0, description="hardest braking [m/s^2], 0.01 to 12"
    )
    max_speed: Positive = Field(
        40.0,
        ge=0.1,
        le=70.0,
        description="the agent accelerates up to this speed [m/s], 0.1 to 70",
    )


class Action(Section):
    """The agent's action."""

    max_yaw_acceleration: Positive = Field(
        0.5, ge=0.01, le=5.0, description="largest yaw acceleration [rad/s^2], 0.01 to 5"
    )
    longitudinal: Longitudinal | None = Field(
        None, description="a second action, the longitudinal acceleration [section], null for none"
    )


FeatureName = Literal[
    "speed",
    "acceleration",
    "lateral_deviation",
    "lateral_speed",
    "yaw",
    "yaw_rate",
    "curvature",
    "leader_gap",
    "leader_relative_speed",
    "follower_gap",
    "follower_relative_speed",
    "target_leader_gap",
    "target_leader_relative_speed",
    "target_follower_gap",
    "target_follower_relative_speed",
    "phase",
    "time",
    "car_following_acceleration",
    "distance_to_end",
]
PAPER_FEATURES: tuple[FeatureName, ...] = (
    "speed",
    "acceleration",
    "lateral_deviation",
    "yaw",
    "yaw_rate",
    "curvature",
)


class Grid(Section):
    """The occupancy grid around an agent: lanes beside each other, each divided into stretches."""

    num_lanes: Count = Field(
        3,
        ge=1,
        le=7,
        description="lanes, the origin lane in the middle [count], 1 to 7, odd",
    )
    num_stretches: Count = Field(
        20, ge=2, le=60, description="stretches of each lane, half of them ahead [count], 2 to 60"
    )
    stretch: Positive = Field(5.0, ge=1.0, le=50.0, description="length of a stretch [m], 1 to 50")

    @model_validator(mode="after")
    def _check_middle(self) -> Self:
        if self.num_lanes % 2 == 0:
            raise ValueError(f"num_lanes = {self.num_lanes}: must be odd")
        return self


class Observation(Section):
    """What an agent observes."""

    features: tuple[FeatureName, ...] = Field(
        PAPER_FEATURES,
        min_length=1,
        max_length=len(get_args(FeatureName)),
        description="feature names in order [list], no duplicates",
    )
    grid: Grid | None = Field(
        None, description="an occupancy grid beside the features [section], null for none"
    )
    num_stacked: Count = Field(
        1,
        ge=1,
        le=64,
        description="observations that it sees, the newest first: this step's and those of the "
        "steps before [count], 1 to 64",
    )
    sensor_range: Positive = Field(
        200.0,
        ge=1.0,
        le=10_000.0,
        description="largest gap that is observed, also the gap if there is no vehicle [m], "
        "1 to 10,000",
    )

    @model_validator(mode="after")
    def _check_features(self) -> Self:
        twice = sorted({name for name in self.features if self.features.count(name) > 1})
        if twice:
            raise ValueError(f"features: {twice} must appear only once")
        return self


class Reward(Section):
    """Eq. 10, Eq. 11, Eq. 12 and the failure penalty."""

    yaw_acceleration_weight: Weight = Field(2.0, description="w_acce [1/(rad/s^2)], 0 to 1e6")
    yaw_rate_weight: Weight = Field(0.5, description="w_rate [1/(rad/s)], 0 to 1e6")
    deviation_weight: Weight = Field(0.05, description="w_dev [1], 0 to 1e6")
    average_deviation: Positive = Field(
        1.875, ge=0.01, le=1000.0, description="d_avg [m], 0.01 to 1000"
    )
    failure_penalty: Weight = Field(
        10.0, description="cost of a collision or of leaving the road [1], 0 to 1e6"
    )
    delay_weight: Weight = Field(
        0.0, description="cost of each second since the command [1/s], 0 to 1e6"
    )
    longitudinal_weight: Weight = Field(
        0.0,
        description="weight of the square of the difference between the acceleration and car "
        "following [s^4/m^2], 0 to 1e6",
    )
