"""Estimates of a training's memory, before anything of it is made."""

from collections.abc import Iterator, Sequence
from itertools import pairwise

from marl_lanes.envs.sizes import bytes_of_state
from marl_lanes.memory import check_memory
from marl_lanes.scenario import Scenario
from marl_lanes.scenario.messages import shown
from marl_lanes.traffic.placement import bytes_of_road
from marl_lanes.traffic.roles.changer import CHANGER
from marl_lanes.traffic.roles.follower import FOLLOWER
from marl_lanes.training.config import (
    ChangersConfig,
    LearnerConfig,
    OffPolicyConfig,
    OnPolicyConfig,
)

FLAGS = 32
"""[bytes] Of a transition besides observations and actions, at most."""

RECORDED = 40_000
"""[bytes] Of a recorded maneuver, about 100 steps."""

NETWORKS = 6
"""In an algorithm, at most: of mu, M and V, or of an actor and critics."""

COPIES = 6
"""Of a weight: itself, its gradient, Adam's two, the target's, the policy's."""

NUMBER = 4.0
"""[bytes]"""

WORKER = 300 * 2**20
"""[bytes] Of a process that has imported torch."""


def check_networks(
    config: LearnerConfig, name: str, widths: Sequence[int], num_features: int, section: str = ""
) -> None:
    """Refuse networks that do not fit in memory.

    Args:
        config: of the learner.
        name: of the field of the widths.
        widths: of the hidden layers.
        num_features: of an observation.
        section: text before the names of the config's fields.

    Raises:
        ValueError: the message names the field that is too large.
    """
    weights = NETWORKS * sum(one * other for one, other in pairwise([num_features, *widths, 1]))
    name = f"{name} = {shown(list(widths))}: number of weights"
    check_memory(name, weights, NUMBER * COPIES * weights)
    # What the backward pass needs of every layer, and its gradient.
    each = 2.0 * NUMBER * NETWORKS * sum(widths)
    for field, size in _batch_sizes(config):
        check_memory(f"{section}{field}", size, size * each)


def check_sizes(
    config: LearnerConfig,
    collected: Scenario,
    evaluated: Scenario,
    section: str = "",
    *,
    has_state: bool = False,
) -> None:
    """Refuse a training that needs more memory than there is, networks left out.

    Args:
        config: of the learner.
        collected: the scenario in which it collects.
        evaluated: the scenario of the evaluations, with ``num_agents``.
        section: text before the names of the config's fields.
        has_state: whether the environment that collects has the road's state.

    Raises:
        ValueError: the message names the first field that is too large.
    """
    for name, value, each in _estimates(config, collected, evaluated, has_state=has_state):
        check_memory(f"{section}{name}", value, float(value) * each)


def _batch_sizes(config: LearnerConfig) -> Iterator[tuple[str, int]]:
    """Name and value of the field that says how large a batch of an update is."""
    if isinstance(config, OffPolicyConfig):
        yield "replay.batch_size", config.replay.batch_size
    if isinstance(config, OnPolicyConfig):
        yield "epochs.batch_size", config.epochs.batch_size


def _num_columns(scenario: Scenario) -> int:
    return max(len(role.seen(scenario)) for role in (CHANGER, FOLLOWER))


def _estimates(
    config: LearnerConfig, collected: Scenario, evaluated: Scenario, *, has_state: bool
) -> Iterator[tuple[str, int, float]]:
    """Name, value, and bytes for each one of it."""
    collector, evaluation = config.collector, config.evaluation
    row = 4 * (2 * _num_columns(collected) + len(CHANGER.act(collected))) + FLAGS
    yield "collector.num_envs", collector.num_envs, bytes_of_road(collected)
    # The batch, and the steps that it is stacked from.
    state = bytes_of_state(collected) if has_state else 0
    # An agent that acts has the state of its own, besides.
    steps = 2.0 * collector.num_envs * (collected.num_slots * (row + state) + state)
    yield "collector.steps_per_batch", collector.steps_per_batch, steps
    if isinstance(config, OffPolicyConfig) and config.replay.storage == "memory":
        replay = config.replay
        yield "replay.capacity", replay.capacity, row * (1.0 + replay.rare_share)
    for field, size in _batch_sizes(config):
        yield field, size, row
    driven = bytes_of_road(evaluated) / (evaluated.num_agents or 1)
    for name in ("num_maneuvers", "final_num_maneuvers"):
        yield f"evaluation.{name}", getattr(evaluation, name), driven + RECORDED
    if isinstance(config, ChangersConfig) and config.collector.kind == "multi":
        yield "num_workers", config.num_workers, WORKER
