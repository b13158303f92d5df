"""Configuration of training programs: fields, limits, meanings. The values are in YAML files."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self, TypeVar

import torch
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError, model_validator

from marl_lanes.files import write_text
from marl_lanes.scenario.fields import Count, NonNegative, Positive, Real, Section
from marl_lanes.scenario.messages import explain, shown
from marl_lanes.scenario.yaml_files import YamlError, format_yaml, read_yaml

CONFIG_FILE = "config.yaml"
"""File name of a run's configuration."""

EVALUATED = (
    "success_rate",
    "completion_rate",
    "cost_ratio",
    "mean_episode_reward",
    "mean_return",
    "mean_num_steps",
    "lost_after_rate",
    "collided_after_rate",
    "left_lane_after_rate",
)
"""The metrics of each saved model that go into its table."""


def _check_device(name: str) -> str:
    count = torch.cuda.device_count()
    try:
        device = torch.device(name)
    except RuntimeError:
        device = torch.device("meta")
    is_gpu = device.type == "cuda" and (device.index or 0) < count
    if not is_gpu and device != torch.device("cpu"):
        raise ValueError(
            f"must be cpu, or cuda[:N] with N below the number of GPUs that torch can use, {count}"
        )
    return name


Number = Annotated[Count, Field(ge=1, le=10**12)]
CountOrZero = Annotated[Count, Field(ge=0, le=10**12)]
Processes = Annotated[Count, Field(ge=1, le=1024)]
Seed = Annotated[Count, Field(ge=0, lt=2**63)]
Device = Annotated[str, AfterValidator(_check_device)]
Widths = Annotated[list[Number], Field(min_length=1, max_length=32)]
Magnitude = Annotated[Positive, Field(le=1e30)]
"""What float32 holds, and its square in float64."""
Sigma = Annotated[NonNegative, Field(le=100.0)]


class CollectorConfig(Section):
    """How transitions are collected."""

    num_envs: Number = Field(description="roads that advance together")
    steps_per_batch: Number = Field(
        description="time steps of every road between two rounds of updates"
    )
    total_transitions: Number = Field(
        description="transitions of acting agents after which the training ends"
    )


class DistributedCollectorConfig(CollectorConfig):
    """How and where transitions are collected."""

    kind: Literal["single", "multi", "ray"] = Field(
        description="single: in this process; multi: in processes of this machine; ray: on a Ray "
        "cluster"
    )


class ReplayConfig(Section):
    """The replay buffer."""

    capacity: Number = Field(description="newest transitions kept")
    storage: Literal["memory", "memmap"] = Field(
        description="memory, or memmap: files in the run folder"
    )
    batch_size: Number = Field(description="transitions an update")
    rare_share: Real = Field(
        ge=0.0,
        lt=1.0,
        description="share of these that are drawn among the transitions of changes that were "
        "turned back",
    )
    warmup_transitions: CountOrZero = Field(description="transitions before the first update")


class EpochsConfig(Section):
    """The newest batch, from which updates without a replay buffer are made."""

    num_epochs: Number = Field(description="times that each of its transitions is used")
    batch_size: Number = Field(description="transitions an update, about")


class OptimizerConfig(Section):
    """Adam."""

    learning_rate: Magnitude = Field(description="step size")
    final_rate: Real = Field(
        gt=0.0,
        le=1.0,
        description="share of the step sizes that is left at the end; they fall linearly",
    )
    max_gradient_norm: Magnitude | None = Field(
        description="gradients are scaled down to this norm; null: not"
    )


class OffPolicyOptimizerConfig(OptimizerConfig):
    """Adam, for updates from a replay buffer."""

    transitions_per_update: Real = Field(
        ge=1e-3, le=1e12, description="new transitions for each update"
    )


class ExplorationConfig(Section):
    """Gaussian noise on the greedy action."""

    initial_sigma: Sigma = Field(description="at the start, of each action's half range [1]")
    final_sigma: Sigma = Field(
        description="from annealing_transitions on, of each action's half range [1]"
    )
    annealing_transitions: CountOrZero = Field(
        description="transitions over which it falls, linearly"
    )
    probability: Real = Field(
        gt=0.0,
        le=1.0,
        description="of noise, for each agent in each step; its other actions are greedy",
    )
    longitudinal_factor: Positive = Field(
        le=1000.0,
        description="multiplies the noise of a second action, the longitudinal acceleration [1]",
    )

    @model_validator(mode="after")
    def _check_fall(self) -> Self:
        if self.final_sigma > self.initial_sigma:
            raise ValueError(
                f"final_sigma = {self.final_sigma}: must be at most initial_sigma = "
                f"{self.initial_sigma}"
            )
        return self


class EvaluationConfig(Section):
    """How good the policy is, meanwhile and at the end."""

    metrics: ClassVar[tuple[str, ...]] = EVALUATED
    """Metrics in the table of the saved models; the criterion must be one of them."""

    save_interval: Number = Field(
        description="transitions between two saved models, each of which is evaluated"
    )
    num_maneuvers: Number = Field(description="maneuvers for each saved model")
    final_num_maneuvers: Number = Field(
        description="maneuvers for the final one, whose metrics are evaluation.json"
    )
    seed: Seed = Field(
        description="of the final evaluation's traffic; that of the saved models' has the next one"
    )
    criterion: str | None = Field(
        description="the metric that is highest for the saved model that becomes the final one; "
        "null: the last"
    )
    record: bool = Field(
        strict=True,
        description="record the first road of each saved model's evaluation, film the first, "
        "the final and the last model, and make replays of the final model's failures",
    )

    @property
    def saved_models_seed(self) -> int:
        """Seed of the traffic when a saved model is evaluated.

        The best of many models looks a little too good on the maneuvers that chose it, so the final
        evaluation uses other ones.
        """
        return self.seed + 1

    @model_validator(mode="after")
    def _check_criterion(self) -> Self:
        if self.criterion is not None and self.criterion not in self.metrics:
            raise ValueError(
                f"criterion = {self.criterion!r}: must be null, {', '.join(self.metrics)}"
            )
        return self


class LearnerConfig(Section):
    """How one group learns."""

    collector: CollectorConfig
    optimizer: OptimizerConfig
    evaluation: EvaluationConfig


class OffPolicyConfig(LearnerConfig):
    """How one group learns from a replay buffer."""

    replay: ReplayConfig
    optimizer: OffPolicyOptimizerConfig

    @model_validator(mode="after")
    def _check_warmup(self) -> Self:
        warmup, total = self.replay.warmup_transitions, self.collector.total_transitions
        if warmup >= total:
            raise ValueError(
                f"replay.warmup_transitions = {warmup}: must be below collector.total_transitions "
                f"= {total}, or nothing is learned"
            )
        return self


class OnPolicyConfig(LearnerConfig):
    """How one group learns from what its present policy has done."""

    epochs: EpochsConfig


class ProgramConfig(Section):
    """Fields of every training program."""

    # Hydra reads the name of a folder 2024 as a number.
    model_config = ConfigDict(coerce_numbers_to_str=True)

    scenario: str = Field(
        min_length=1,
        description="name or path of the scenario; the evaluation is on it, unchanged",
    )
    training_overrides: dict[str, Any] = Field(
        description="scenario fields replaced while transitions are collected"
    )
    seed: Seed = Field(description="of the traffic, the networks, the noise and the replay")
    output: str = Field(min_length=1, description="the run folder")
    resume: str | None = Field(
        description="a run folder to continue, with its own config; nothing else may be given, "
        "but ray.address where that is a field"
    )
    num_threads: Processes = Field(description="threads of torch")
    device: Device = Field(
        description="where the network acts and learns, and where one process collects for "
        "changers the roads are: cpu, or cuda[:N]"
    )


class RayConfig(Section):
    """The Ray cluster, where there is one."""

    address: str | None = Field(
        description="HOST:PORT; null: RAY_ADDRESS, else the cluster of this machine, else a new "
        "one on it"
    )


class ChangersConfig(LearnerConfig, ProgramConfig):
    """Fields of every program that trains the lane changers."""

    collector: DistributedCollectorConfig
    num_workers: Processes = Field(
        description="processes that collect, with collector=multi or ray; each has its share of "
        "num_envs"
    )
    ray: RayConfig

    @model_validator(mode="after")
    def _check_workers(self) -> Self:
        number, num_envs = self.num_workers, self.collector.num_envs
        if self.collector.kind == "single" and number != 1:
            raise ValueError(f"num_workers = {number}: must be 1 with collector=single")
        if self.collector.kind != "ray" and self.ray.address is not None:
            raise ValueError(f"ray.address = {self.ray.address!r}: must be null without ray")
        if num_envs % number:
            raise ValueError(
                f"collector.num_envs = {num_envs}: must be a multiple of num_workers = {number}"
            )
        return self


class ConfigError(ValueError):
    """A configuration that cannot be; the message names field, value and what is allowed."""


Config = TypeVar("Config", bound=ProgramConfig)
ChangersKind = TypeVar("ChangersKind", bound=ChangersConfig)
Model = TypeVar("Model", bound=BaseModel)


def validate(kind: type[Model], fields: Mapping[str, Any], origin: str = "") -> Model:
    """Check the fields and make a ``kind`` of them.

    Args:
        kind: the model.
        fields: plain values, nested.
        origin: text in front of the message.

    Raises:
        ConfigError: a field is out of range, of another type, unknown or missing.
    """
    try:
        return kind.model_validate(fields)
    except ValidationError as error:
        raise ConfigError(origin + explain(error, kind)) from None


def read_config(kind: type[Config], fields: Mapping[str, Any]) -> Config:
    """The configuration, or that of the run to resume, if ``fields`` names one.

    Raises:
        ConfigError: a field is not valid, or there is no run to resume, or it has other fields.
    """
    if fields.get("resume") is None:
        return validate(kind, fields)
    resume = str(fields["resume"])
    origin = f"resume = {resume!r}: "
    stored = _read_stored(Path(resume), origin) | {"output": resume, "resume": resume}
    return validate(kind, stored, f"{origin}its {CONFIG_FILE}: ")


def _read_stored(folder: Path, origin: str) -> dict[str, Any]:
    """The fields of a run's configuration as they are; ``origin`` begins every message."""
    path = folder / CONFIG_FILE
    if not path.is_file():
        raise ConfigError(f"{origin}must be a run folder; it has no {CONFIG_FILE}")
    try:
        stored = read_yaml(path)
    except YamlError as error:
        raise ConfigError(f"{origin}its {CONFIG_FILE}: {error}") from None
    if not isinstance(stored, dict):
        raise ConfigError(
            f"{origin}its {CONFIG_FILE}: must be a mapping of fields, got {shown(stored)}"
        )
    return stored


def read_changers_config(kind: type[ChangersKind], fields: Mapping[str, Any]) -> ChangersKind:
    """As ``read_config``; a resumed run may use another Ray cluster.

    Raises:
        ConfigError: as for ``read_config``.
    """
    config = read_config(kind, fields)
    given = fields.get("ray")
    if config.resume is None or not isinstance(given, Mapping) or given.get("address") is None:
        return config
    return config.model_copy(update={"ray": validate(RayConfig, given, "ray.")})


def write_config(path: Path, config: ProgramConfig) -> None:
    """Write the whole configuration as YAML."""
    write_text(path, format_yaml(config.model_dump(mode="json")))
