"""The typed configuration of a training program; its values are in the program's YAML files."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import inf
from pathlib import Path
from typing import Any, TypeVar, cast

import torch
from hydra.core.config_store import ConfigStore
from omegaconf import MISSING, DictConfig, OmegaConf
from omegaconf.errors import MissingMandatoryValue

from marl_lanes.files import write_atomically

CONFIG_FILE = "config.yaml"
"""File name of a run's configuration."""


@dataclass
class CollectorConfig:
    """How transitions are collected."""

    num_envs: int = MISSING
    """Roads that advance together."""
    steps_per_batch: int = MISSING
    """Time steps of every road between two rounds of updates."""
    total_transitions: int = MISSING
    """Transitions of acting agents after which the training ends."""


@dataclass
class DistributedCollectorConfig(CollectorConfig):
    """Where they are collected, too."""

    kind: str = MISSING
    """single: in this process; multi: in processes of this machine; ray: on a Ray cluster."""


@dataclass
class ReplayConfig:
    """What the updates are drawn from."""

    capacity: int = MISSING
    """Newest transitions kept."""
    storage: str = MISSING
    """memory, or memmap: files in the run folder."""
    batch_size: int = MISSING
    """Transitions an update."""
    rare_share: float = MISSING
    """Share of these that are drawn among the transitions of changes that were turned back."""
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
    final_rate: float = MISSING
    """Share of both step sizes that is left at the end; they fall linearly through stage two."""
    max_gradient_norm: float | None = MISSING
    """Gradients are scaled down to this norm; null: not."""
    transitions_per_update: float = MISSING
    """New transitions for each update."""
    pretraining_transitions: int = MISSING
    """Length of stage one, which trains M and V alone."""
    compile: bool = MISSING
    """Whether the loss goes through torch.compile; the first update then takes a minute."""


@dataclass
class ExplorationConfig:
    """Gaussian noise on the greedy action."""

    initial_sigma: float = MISSING
    """At the start, of each action's half range [1]."""
    final_sigma: float = MISSING
    """From annealing_transitions on, of each action's half range [1]."""
    annealing_transitions: int = MISSING
    """Transitions over which it falls, linearly."""
    longitudinal_factor: float = MISSING
    """Multiplies the noise of a second action, the longitudinal acceleration [1]."""


@dataclass
class EvaluationConfig:
    """How good the policy is, meanwhile and at the end."""

    save_interval: int = MISSING
    """Transitions between two saved models, each of which is evaluated."""
    num_maneuvers: int = MISSING
    """Maneuvers for each saved model."""
    final_num_maneuvers: int = MISSING
    """Maneuvers for the final one, whose metrics are evaluation.json."""
    seed: int = MISSING
    """Of the final evaluation's traffic; that of the saved models' has the next one."""
    criterion: str | None = MISSING
    """The metric that is highest for the saved model that becomes the final one; null: the last."""


@dataclass
class LearnerConfig:
    """How one group learns."""

    collector: CollectorConfig = field(default_factory=CollectorConfig)
    replay: ReplayConfig = field(default_factory=ReplayConfig)
    loss: LossConfig = field(default_factory=LossConfig)
    optimizer: OptimizerConfig = field(default_factory=OptimizerConfig)
    exploration: ExplorationConfig = field(default_factory=ExplorationConfig)
    evaluation: EvaluationConfig = field(default_factory=EvaluationConfig)


@dataclass
class ProgramConfig:
    """What every training program is told."""

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
    device: str = MISSING
    """Where the network acts and learns: cpu, or cuda[:N]; the traffic is on the CPU."""


@dataclass
class NetworkConfig:
    """Form of the NAF network."""

    mu: str = MISSING
    """cascade, paper, damped or mlp; with two actions the first three with +idm or +mlp, or mlp."""
    knows_action_cost: bool = MISSING
    """Whether Q has the reward's own cost of the yaw acceleration in it; with mu cascade alone."""
    hidden_sizes: list[int] = MISSING
    """Widths of the hidden layers of every network."""


@dataclass
class RayConfig:
    """The Ray cluster, where there is one."""

    address: str | None = None
    """HOST:PORT; null: RAY_ADDRESS, else the cluster of this machine, else a new one on it."""


@dataclass
class TrainingConfig(LearnerConfig, ProgramConfig):
    """Everything that defines a run of agents/naf/train.py."""

    collector: DistributedCollectorConfig = field(default_factory=DistributedCollectorConfig)
    num_workers: int = MISSING
    """Processes that collect, with collector=multi or ray; each has its share of num_envs."""
    ray: RayConfig = field(default_factory=RayConfig)
    recipe: str = MISSING
    """The recipe's name."""
    network: NetworkConfig = field(default_factory=NetworkConfig)
    initial_checkpoint: str | None = None
    """A checkpoint whose weights the training starts from; null: from none."""


class ConfigError(ValueError):
    """A configuration that cannot be; the message names field, value and what is allowed."""


def register(name: str, kind: type[ProgramConfig]) -> None:
    """Make the schema ``kind`` known to hydra under the name that the YAML files extend."""
    ConfigStore.instance().store(name=name, node=kind)


Config = TypeVar("Config", bound=ProgramConfig)


def read_config(given: DictConfig, kind: type[Config]) -> Config:
    """The typed configuration; that of the run to resume, where one is named.

    Raises:
        ConfigError: there is no run to resume, or a field has no value: a run of another version.
    """
    resume = given.resume
    if resume is not None:
        path = Path(resume) / CONFIG_FILE
        if not path.is_file():
            raise ConfigError(f"resume = {resume!r}: must be a run folder; it has no {CONFIG_FILE}")
        stored = OmegaConf.merge(OmegaConf.structured(kind), OmegaConf.load(path))
        stored.output, stored.resume = resume, resume
        given = cast("DictConfig", stored)
    try:
        return cast("Config", OmegaConf.to_object(given))
    except MissingMandatoryValue as error:
        place = "the command line and its YAML files" if resume is None else f"resume = {resume!r}"
        raise ConfigError(f"{error.full_key}: must have a value; {place} gives none") from None


def write_config(path: Path, config: ProgramConfig) -> None:
    """Write the whole configuration as YAML."""
    text = OmegaConf.to_yaml(OmegaConf.structured(config))
    write_atomically(path, lambda temporary: temporary.write_text(text, encoding="utf-8"))


def check(config: TrainingConfig) -> None:
    """Refuse values outside their ranges, before anything is built or written.

    Raises:
        ConfigError: for the first field that is out of range.
    """
    check_program(config)
    check_learner(config)
    check_widths("network.hidden_sizes", config.network.hidden_sizes)
    check_workers(config)


def check_workers(config: TrainingConfig) -> None:
    """What ``check`` says of where transitions are collected."""
    kind, number = config.collector.kind, config.num_workers
    require(kind in {"single", "multi", "ray"}, "collector.kind", kind, "single, multi, ray")
    require(number >= 1, "num_workers", number, "at least 1")
    if kind == "single":
        require(number == 1, "num_workers", number, "1 with collector=single")
    if kind != "ray":
        require(config.ray.address is None, "ray.address", config.ray.address, "null without ray")
    num_envs = config.collector.num_envs
    require(
        num_envs % number == 0,
        "collector.num_envs",
        num_envs,
        f"a multiple of num_workers = {number}",
    )


def check_program(config: ProgramConfig) -> None:
    """What ``check`` says of the fields that every program has."""
    require(config.num_threads >= 1, "num_threads", config.num_threads, "at least 1")
    _check_seed("seed", config.seed)
    _check_device(config.device)


def check_widths(name: str, sizes: Sequence[int]) -> None:
    """What ``check`` says of the widths of hidden layers."""
    require(len(sizes) > 0 and min(sizes) >= 1, name, sizes, "widths of at least 1")


def check_criterion(config: LearnerConfig, metrics: Sequence[str], prefix: str = "") -> None:
    """Refuse a criterion that is not among the metrics of the saved models.

    Raises:
        ConfigError: it is not.
    """
    criterion = config.evaluation.criterion
    allowed = f"null, {', '.join(metrics)}"
    is_known = criterion is None or criterion in metrics
    require(is_known, prefix + "evaluation.criterion", criterion, allowed)


def check_learner(config: LearnerConfig, prefix: str = "") -> None:
    """What ``check`` says of one group's learning; ``prefix`` stands before the fields' names."""
    at_least_one = {
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
        "replay.warmup_transitions": config.replay.warmup_transitions,
        "optimizer.pretraining_transitions": config.optimizer.pretraining_transitions,
        "exploration.initial_sigma": config.exploration.initial_sigma,
        "exploration.annealing_transitions": config.exploration.annealing_transitions,
    }
    positive = {
        "optimizer.learning_rate": config.optimizer.learning_rate,
        "optimizer.mu_learning_rate": config.optimizer.mu_learning_rate,
        "optimizer.transitions_per_update": config.optimizer.transitions_per_update,
        "exploration.longitudinal_factor": config.exploration.longitudinal_factor,
    }
    if config.optimizer.max_gradient_norm is not None:
        positive["optimizer.max_gradient_norm"] = config.optimizer.max_gradient_norm
    for name, value in at_least_one.items():
        require(value >= 1, prefix + name, value, "at least 1")
    for name, number in not_negative.items():
        require(0 <= number < inf, prefix + name, number, "at least 0 and finite")
    for name, number in positive.items():
        require(0 < number < inf, prefix + name, number, "above 0 and finite")
    _check_seed(prefix + "evaluation.seed", config.evaluation.seed)
    storage = config.replay.storage
    require(storage in {"memory", "memmap"}, prefix + "replay.storage", storage, "memory, memmap")
    rare_share = config.replay.rare_share
    require(0.0 <= rare_share < 1.0, prefix + "replay.rare_share", rare_share, "in [0, 1)")
    final_rate = config.optimizer.final_rate
    require(0.0 < final_rate <= 1.0, prefix + "optimizer.final_rate", final_rate, "in (0, 1]")
    loss, exploration = config.loss, config.exploration
    require(0.0 <= loss.gamma <= 1.0, prefix + "loss.gamma", loss.gamma, "between 0 and 1")
    require(0.0 < loss.tau <= 1.0, prefix + "loss.tau", loss.tau, "above 0 and at most 1")
    require(
        loss.target_update in {"soft", "hard"},
        prefix + "loss.target_update",
        loss.target_update,
        "soft, hard",
    )
    require(
        0.0 <= exploration.final_sigma <= exploration.initial_sigma,
        prefix + "exploration.final_sigma",
        exploration.final_sigma,
        f"between 0 and exploration.initial_sigma = {exploration.initial_sigma}",
    )


def require(condition: bool, name: str, value: object, allowed: str) -> None:
    """Refuse a field's value unless the condition holds.

    Raises:
        ConfigError: it does not.
    """
    if not condition:
        raise ConfigError(f"{name} = {value!r}: must be {allowed}")


def _check_device(name: str) -> None:
    count = torch.cuda.device_count()
    allowed = "cpu, or cuda[:N] with N below the number of GPUs that torch can use, " + str(count)
    try:
        device = torch.device(name)
    except RuntimeError:
        raise ConfigError(f"device = {name!r}: must be {allowed}") from None
    is_gpu = device.type == "cuda" and (device.index or 0) < count
    require(device == torch.device("cpu") or is_gpu, "device", name, allowed)


def _check_seed(name: str, seed: int) -> None:
    require(seed >= 0, name, seed, "at least 0")
    require(seed < 2**63, name, seed, "below 2^63")
