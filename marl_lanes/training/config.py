"""The typed configuration of a training program; its values are in the program's YAML files."""

from dataclasses import dataclass, field
from math import inf
from typing import Any

from hydra.core.config_store import ConfigStore
from omegaconf import MISSING


@dataclass
class NetworkConfig:
    """Form of the NAF network."""

    mu: str = MISSING
    """paper, damped or mlp."""
    hidden_sizes: list[int] = MISSING
    """Widths of the hidden layers of every network."""


@dataclass
class CollectorConfig:
    """How transitions are collected."""

    num_envs: int = MISSING
    """Roads that advance together."""
    steps_per_batch: int = MISSING
    """Time steps of every road between two rounds of updates."""
    total_transitions: int = MISSING
    """Transitions of steering agents after which the training ends."""


@dataclass
class ReplayConfig:
    """What the updates are drawn from."""

    capacity: int = MISSING
    """Newest transitions kept."""
    batch_size: int = MISSING
    """Transitions an update."""
    warmup_transitions: int = MISSING
    """Transitions before the first update."""


@dataclass
class LossConfig:
    """NAFLoss and its target network."""

    gamma: float = MISSING
    """Discount factor."""
    target_update: str = MISSING
    """soft: Polyak averaging by tau; hard: a copy."""
    tau: float = MISSING
    """Step of the soft update."""
    target_interval: int = MISSING
    """Updates of the network for one of the target."""


@dataclass
class OptimizerConfig:
    """Adam."""

    learning_rate: float = MISSING
    """Step size of M and V."""
    mu_learning_rate: float = MISSING
    """Step size of mu: smaller, V keeps up with the policy that it has to value."""
    max_gradient_norm: float | None = MISSING
    """Gradients are scaled down to this norm; null: not."""
    transitions_per_update: float = MISSING
    """New transitions for each update."""
    pretraining_transitions: int = MISSING
    """Length of stage one, which trains M and V alone."""


@dataclass
class ExplorationConfig:
    """Gaussian noise on the greedy action."""

    initial_sigma: float = MISSING
    """At the start [rad/s^2]."""
    final_sigma: float = MISSING
    """From annealing_transitions on [rad/s^2]."""
    annealing_transitions: int = MISSING
    """Transitions over which it falls, linearly."""


@dataclass
class EvaluationConfig:
    """How good the policy is, meanwhile and at the end."""

    save_interval: int = MISSING
    """Transitions between two saved models, each of which is evaluated."""
    num_maneuvers: int = MISSING
    """Maneuvers for each saved model."""
    final_num_maneuvers: int = MISSING
    """Maneuvers for the last one, whose metrics are evaluation.json."""
    seed: int = MISSING
    """Of the evaluation's traffic."""


@dataclass
class TrainingConfig:
    """Everything that defines a training run."""

    recipe: str = MISSING
    """The recipe's name."""
    scenario: str = MISSING
    """Name or path of the scenario; the evaluation is on it, unchanged."""
    training_overrides: dict[str, Any] = field(default_factory=dict)
    """Scenario fields replaced while transitions are collected."""
    seed: int = MISSING
    """Of the traffic, the networks, the noise and the replay."""
    output: str = MISSING
    """The run folder."""
    resume: str | None = None
    """A run folder to continue; its own config counts, and nothing else on the command line."""
    num_threads: int = MISSING
    """Threads of torch."""
    network: NetworkConfig = field(default_factory=NetworkConfig)
    collector: CollectorConfig = field(default_factory=CollectorConfig)
    replay: ReplayConfig = field(default_factory=ReplayConfig)
    loss: LossConfig = field(default_factory=LossConfig)
    optimizer: OptimizerConfig = field(default_factory=OptimizerConfig)
    exploration: ExplorationConfig = field(default_factory=ExplorationConfig)
    evaluation: EvaluationConfig = field(default_factory=EvaluationConfig)


def register() -> None:
    """Make the schema known to hydra under the name that the YAML files extend."""
    ConfigStore.instance().store(name="training_schema", node=TrainingConfig)


class ConfigError(ValueError):
    """A configuration that cannot be; the message names field, value and what is allowed."""


def check(config: TrainingConfig) -> None:
    """Refuse values outside their ranges, before anything is built or written.

    Raises:
        ConfigError: for the first field that is out of range.
    """
    at_least_one = {
        "num_threads": config.num_threads,
        "collector.num_envs": config.collector.num_envs,
        "collector.steps_per_batch": config.collector.steps_per_batch,
        "collector.total_transitions": config.collector.total_transitions,
        "replay.capacity": config.replay.capacity,
        "replay.batch_size": config.replay.batch_size,
        "loss.target_interval": config.loss.target_interval,
        "evaluation.save_interval": config.evaluation.save_interval,
        "evaluation.num_maneuvers": config.evaluation.num_maneuvers,
        "evaluation.final_num_maneuvers": config.evaluation.final_num_maneuvers,
    }
    not_negative = {
        "seed": config.seed,
        "replay.warmup_transitions": config.replay.warmup_transitions,
        "optimizer.pretraining_transitions": config.optimizer.pretraining_transitions,
        "exploration.initial_sigma": config.exploration.initial_sigma,
        "exploration.annealing_transitions": config.exploration.annealing_transitions,
        "evaluation.seed": config.evaluation.seed,
    }
    positive = {
        "optimizer.learning_rate": config.optimizer.learning_rate,
        "optimizer.mu_learning_rate": config.optimizer.mu_learning_rate,
        "optimizer.transitions_per_update": config.optimizer.transitions_per_update,
    }
    if config.optimizer.max_gradient_norm is not None:
        positive["optimizer.max_gradient_norm"] = config.optimizer.max_gradient_norm
    for name, value in at_least_one.items():
        _require(value >= 1, name, value, "at least 1")
    for name, number in not_negative.items():
        _require(0 <= number < inf, name, number, "at least 0 and finite")
    for name, number in positive.items():
        _require(0 < number < inf, name, number, "above 0 and finite")
    for name, seed in {"seed": config.seed, "evaluation.seed": config.evaluation.seed}.items():
        _require(seed < 2**63, name, seed, "below 2^63")
    sizes = config.network.hidden_sizes
    _require(
        len(sizes) > 0 and min(sizes) >= 1, "network.hidden_sizes", sizes, "widths of at least 1"
    )
    loss, exploration = config.loss, config.exploration
    _require(0.0 <= loss.gamma <= 1.0, "loss.gamma", loss.gamma, "between 0 and 1")
    _require(0.0 < loss.tau <= 1.0, "loss.tau", loss.tau, "above 0 and at most 1")
    _require(
        loss.target_update in {"soft", "hard"},
        "loss.target_update",
        loss.target_update,
        "soft, hard",
    )
    _require(
        0.0 <= exploration.final_sigma <= exploration.initial_sigma,
        "exploration.final_sigma",
        exploration.final_sigma,
        f"between 0 and exploration.initial_sigma = {exploration.initial_sigma}",
    )


def _require(condition: bool, name: str, value: object, allowed: str) -> None:
    if not condition:
        raise ConfigError(f"{name} = {value!r}: must be {allowed}")
