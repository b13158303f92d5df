"""Scenarios drawn by hypothesis, with the drivers and the actions on them.

``drawn()`` is the strategy. A ``Drawn`` is one scenario with its actions; its ``repr`` is the call
that makes it again, so what hypothesis prints of a failure can be pasted into a test.
"""

from dataclasses import dataclass, field, replace
from functools import cached_property, partial

import numpy as np
from comparing import EVERY_FEATURE
from hypothesis import HealthCheck, assume, settings
from hypothesis import strategies as st
from staging import damped_actions

from marl_lanes.scenario import ScenarioError, load_scenario
from marl_lanes.scenario.schema import MAX_KEEPING_STEP, MIN_KEEPING_SHARE
from marl_lanes.traffic.roles.external import FOLLOWER_COLUMNS
from marl_lanes.traffic.simulator import Simulator

BUSY = {
    "road": {"length": 400.0, "num_lanes": 5},
    "command": {"position": [20.0, 80.0], "probability": 1.0},
    "departures": {"interval": [1.0, 3.0], "initial_speed": [6.0, 20.0]},
    "warmup": [0.0, 15.0],
    "max_vehicles": 24,
    "num_agents": None,
    "horizon": None,
    "observation": EVERY_FEATURE,
}
"""What every drawn scenario has where nothing else is drawn: the paper's, short, wide and full."""
BASE = load_scenario("paper", BUSY)


def share_of(examples, *, is_whole):
    """Settings of a property: the whole number of examples, or a small, repeatable share."""
    return settings(
        max_examples=examples,
        derandomize=not is_whole,
        database=None,
        deadline=None,
        suppress_health_check=list(HealthCheck),
    )


@dataclass(frozen=True)
class Drawn:
    """A scenario and how its agents act.

    Args:
        overrides: of the paper's scenario, beside BUSY.
        seed: of the roads and of the actions.
        noise: of the changers' steering toward their lanes, as a share of 1 rad/s^2.
        bias: of their steering [rad/s^2].
        pushing: mean acceleration that learned followers choose [m/s^2].
    """

    overrides: dict = field(default_factory=dict)
    seed: int = 0
    noise: float = 0.0
    bias: float = 0.0
    pushing: float = 0.0

    @cached_property
    def scenario(self):
        return load_scenario(BASE, self.overrides)

    def but(self, **overrides):
        """The same with other values of top-level fields."""
        return replace(self, overrides=self.overrides | overrides)

    @property
    def has_learner(self):
        return "learned" in self.scenario.followers.mix

    @cached_property
    def policies(self):
        """The policies by name, within the scenario's bounds."""
        bounds = self.scenario.followers.external
        return {
            name: partial(policy, -bounds.max_braking, bounds.max_acceleration)
            for name, policy in POLICIES.items()
        }

    def simulator(self, num_envs=1, **options):
        """Roads of the scenario, reset."""
        simulator = Simulator(
            self.scenario,
            num_envs,
            seed=self.seed,
            learned_followers=self.has_learner,
            follower_policies=self.policies,
            **options,
        )
        simulator.reset()
        return simulator

    def choose(self, simulator, generator):
        """Actions of the changers (E, A, D) and of the learned followers (E, A, 1) for a step."""
        actions = damped_actions(simulator, self.noise, generator)
        actions[..., 0] += self.bias
        return actions, self.pushing + generator.uniform(-7.0, 7.0, (*actions.shape[:2], 1))


def _keep_distance(low, high, seen):
    return np.clip(0.2 * (seen[:, FOLLOWER_COLUMNS["gap"]] - 10.0), low, high)


def _press_on(low, high, seen):
    return np.clip(0.1 * seen[:, FOLLOWER_COLUMNS["speed"]], low, high)


POLICIES = {"polite": _keep_distance, "rude": _press_on}


def numbers(low, high):
    """Numbers of few digits: they shrink to short ones."""
    return st.floats(low, high).map(lambda value: round(value, 3))


def ranges(low, high):
    return st.lists(numbers(low, high), min_size=2, max_size=2).map(sorted)


def mixes(*names):
    shares = st.sampled_from([1.0, 0.3])
    return st.dictionaries(st.sampled_from(names), shares, min_size=1, max_size=len(names))


def section(**fields):
    """A section of which any fields are drawn, or none."""
    return st.fixed_dictionaries({}, optional=fields)


PROFILES = section(
    minimum_gap=numbers(0.5, 8.0),
    time_headway=numbers(0.2, 2.5),
    max_acceleration=numbers(0.5, 5.0),
    comfortable_braking=numbers(0.5, 5.0),
    exponent=numbers(1.0, 8.0),
    comfortable_lateral_acceleration=numbers(0.5, 4.0),
    length=numbers(2.0, 20.0),
    width=numbers(0.5, 2.55),
    desired_speed=ranges(3.0, 45.0),
)
DRIVERS = section(
    car_following=st.sampled_from(["max", "sum", "acc"]),
    coolness=numbers(0.0, 1.0),
    profiles=section(normal=PROFILES, aggressive=PROFILES, truck=PROFILES),
    mix=mixes("truck", "normal", "aggressive", "defensive"),
)
DEPARTURES = section(
    interval=ranges(0.4, 6.0), initial_speed=ranges(1.0, 30.0), desired_speed=ranges(3.0, 45.0)
)
OPEN_GAP = {"rule": "kinematic", "minimum_gap": 0.0, "time_gap": 0.0, "max_braking": 50.0}
GAP = st.one_of(
    st.just(OPEN_GAP),
    section(
        rule=st.just("kinematic"),
        minimum_gap=numbers(0.0, 5.0),
        time_gap=numbers(0.0, 1.0),
        max_braking=numbers(0.5, 50.0),
        speed_factor=numbers(1.0, 2.0),
    ),
    section(
        safe_braking=numbers(1.5, 9.0),
        braking_margin=numbers(0.0, 1.4),
        speed_factor=numbers(1.0, 2.0),
        minimum_gap=numbers(0.0, 5.0),
        max_braking=numbers(0.5, 9.0),
    ),
)
EXTERNAL = section(
    max_acceleration=numbers(0.5, 6.0),
    max_braking=numbers(0.5, 8.0),
    max_speed=numbers(10.0, 50.0),
    is_guarded=st.booleans(),
)
RECKLESS = {"max_acceleration": 6.0, "max_speed": 60.0, "is_guarded": False}
FOLLOWERS = st.one_of(
    mixes("learned", "rude").map(lambda mix: {"mix": mix, "external": RECKLESS}),
    mixes("cooperative").map(lambda mix: {"mix": mix, "cooperative": {"moves_over": True}}),
    section(
        mix=mixes("neutral", "cooperative", "adversarial", "learned", "polite", "rude"),
        cooperative=section(
            time_headway=numbers(0.3, 3.0), max_braking=numbers(0.5, 6.0), moves_over=st.just(True)
        ),
        adversarial=section(
            desired_speed_factor=numbers(1.0, 2.0),
            max_acceleration=numbers(0.5, 6.0),
            time_headway=numbers(0.1, 1.5),
        ),
        external=EXTERNAL,
        learned=section(objective=st.sampled_from(["cooperative", "adversarial"])),
    ),
)
COMPLETION = section(
    max_deviation=numbers(0.05, 1.2),
    max_lateral_speed=st.none() | numbers(0.05, 1.0),
    max_yaw_rate=st.none() | numbers(0.01, 0.3),
)
ACTION = section(
    max_yaw_acceleration=numbers(0.1, 5.0),
    longitudinal=section(
        max_acceleration=numbers(0.5, 4.0),
        max_braking=numbers(0.5, 8.0),
        max_speed=numbers(10.0, 50.0),
    ),
)
REWARD = section(
    delay_weight=numbers(0.0, 2.0),
    longitudinal_weight=numbers(0.0, 2.0),
    failure_penalty=numbers(0.0, 20.0),
    deviation_weight=numbers(0.0, 2.0),
    average_deviation=numbers(0.5, 4.0),
)
VEHICLE = section(
    length=numbers(2.0, 9.0),
    width=numbers(0.5, 2.4),
    max_braking=numbers(2.0, 12.0),
    min_turning_radius=numbers(1.0, 20.0),
)
SECTIONS = {
    "drivers": DRIVERS,
    "departures": DEPARTURES,
    "gap": GAP,
    "followers": FOLLOWERS,
    "completion": COMPLETION,
    "action": ACTION,
    "reward": REWARD,
    "vehicle": VEHICLE,
    "observation": section(sensor_range=numbers(10.0, 400.0)),
    "num_slots": st.integers(1, 8),
    "max_vehicles": st.integers(4, 30),
    "num_agents": st.integers(1, 6),
    "horizon": numbers(5.0, 40.0),
    "warmup": ranges(0.0, 20.0),
}


@st.composite
def _roads(draw, length):
    """Lanes and arcs; a radius is doubled until lane keeping can take the curve."""
    road = {"length": length}
    if draw(st.booleans()):
        road["num_lanes"] = draw(st.sampled_from([3, 4, 6, 2]))
    if draw(st.booleans()):
        road["lane_width"] = draw(numbers(2.6, 5.0))
    arcs, place = [], 0.0
    for _ in range(draw(st.integers(0, 3))):
        start = round(place + draw(numbers(0.0, 100.0)), 3)
        end = round(start + draw(numbers(10.0, 200.0)), 3)
        if end > length:
            break
        share = draw(st.sampled_from([0.0, 0.5, 0.25, 0.05]))
        radius = draw(st.sampled_from([1.0, -1.0])) * draw(numbers(50.0, 800.0))
        transition = round(share * (end - start), 3)
        arcs.append({"start": start, "end": end, "radius": radius, "transition": transition})
        place = end
    return road | {"arcs": arcs} if arcs else road


@st.composite
def _overrides(draw):
    overrides = draw(st.fixed_dictionaries({}, optional=SECTIONS))
    if draw(st.booleans()):
        length = draw(numbers(150.0, 800.0))
        overrides["road"] = draw(_roads(length))
        high = 0.4 * length
        lanes = st.integers(0, overrides["road"].get("num_lanes", 5) - 1)
        overrides["command"] = draw(
            section(
                position=ranges(0.0, high),
                probability=numbers(0.2, 1.0),
                lanes=st.lists(lanes, min_size=1, unique=True),
                time_limit=numbers(1.0, 20.0),
            )
        )
    if draw(st.booleans()):
        step = overrides["time_step"] = draw(numbers(0.05, 0.5))
        pole = round(draw(numbers(0.3, 1.0)) * min(3.0, MAX_KEEPING_STEP / step), 3) - 0.001
        least = MIN_KEEPING_SHARE * pole
        bound = round(draw(numbers(1.05, 8.0)) * least, 3) + 0.001
        overrides["lane_keeping"] = {"pole": pole, "max_yaw_acceleration": bound}
    return overrides


@st.composite
def drawn(draw):
    """Valid scenarios of all kinds, and actions with which changes complete, abort and fail."""
    # First, for what is drawn last is often the simplest.
    manner = {
        "seed": draw(st.integers(0, 2**64 - 1)),
        "noise": draw(st.sampled_from([0.0, 0.1, 0.4, 5.0])),
        "bias": draw(st.sampled_from([0.0, 0.0, 0.0, 0.3, 3.0])),
        "pushing": draw(st.sampled_from([0.0, 2.0, 5.0])),
    }
    overrides = draw(_overrides())
    arcs = overrides.get("road", {}).get("arcs", [])
    for _ in range(5):
        try:
            load_scenario(BASE, overrides)
        except ScenarioError as error:
            if "road.arcs" not in str(error):
                raise
            for arc in arcs:
                arc["radius"] *= 2.0
        else:
            break
    else:
        assume(False)
    return Drawn(overrides, **manner)
