"""A vehicle, an agent and a follower of the reference, and the names of its drivers and terms."""

from dataclasses import dataclass, field

from marl_lanes.traffic.machine.state import Outcome, Phase

SCRIPTED = ["cooperative", "neutral", "adversarial"]
FOLLOWER_TERMS = "delay", "abort", "collision", "discomfort", "braking"


@dataclass(eq=False)
class Car:
    """A vehicle; lengths in the road frame."""

    id: int
    slot: int
    position: float
    lateral_position: float
    speed: float
    acceleration: float
    yaw: float
    yaw_rate: float
    yaw_acceleration: float
    desired_speed: float
    command_position: float
    lane: int
    profile: str
    disposition: int
    moving_over: int = 0
    advance: float = 0.0
    agent: "Agent | None" = None
    changer: "Car | None" = None
    before: tuple = (0.0, 0.0)
    is_off_road: bool = False
    is_past_end: bool = False
    is_hit: bool = False


@dataclass(eq=False)
class Agent:
    """A live command."""

    slot: int
    car: Car
    command: int
    direction: int
    origin: int
    target: int
    born: int
    phase: Phase = Phase.WAITING
    outcome: Outcome = Outcome.UNFINISHED
    num_aborts: int = 0
    steering_steps: int = 0
    car_following: float = 0.0
    terms: dict = field(default_factory=dict)
    reward: float = 0.0
    episode_reward: float = 0.0
    neighbors: dict = field(default_factory=dict)
    observation: dict = field(default_factory=dict)

    @property
    def is_steering(self):
        return self.phase in (Phase.ENGAGED, Phase.ABORTING)


@dataclass(eq=False)
class Follower:
    """Record of the external driver behind the changer of a live command."""

    car: Car | None = None
    terms: dict = field(default_factory=lambda: dict.fromkeys(FOLLOWER_TERMS, 0.0))
    reward: float = 0.0
    episode_reward: float = 0.0
    observation: list = field(default_factory=list)

    def be_unpaid(self):
        self.terms, self.reward = dict.fromkeys(FOLLOWER_TERMS, 0.0), 0.0
