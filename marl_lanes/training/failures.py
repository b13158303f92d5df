"""How a training fails: what is looked at to notice it, and what the program then says."""

import math
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

import torch
from tensordict import TensorDictBase
from torch import Tensor

from marl_lanes.naf.checkpoint import CheckpointError
from marl_lanes.rendering.encoding import FilmError
from marl_lanes.scenario import Scenario, ScenarioError
from marl_lanes.traffic.roles.changer import CHANGER
from marl_lanes.training.collectors import WorkerError
from marl_lanes.training.config import ConfigError, OptimizerConfig

MAX_WEIGHT = 1e6
"""[1] Those of networks that have learned something are below 100."""

IDLE_TIME = 600.0
"""[s] A training ends if in so much time no agent acts on any road."""

IDLE_ROAD_TIME = 36_000.0
"""[s] Of few roads it is more: as much as this in all."""

STATUS_INTERRUPTED = 130
"""Exit status after a second Ctrl-C, as shells have it."""


class TrainingError(RuntimeError):
    """A training that cannot go on; the message says why."""


def check_losses(losses: Mapping[str, Sequence[float]], updates: int) -> None:
    """Stop at the first loss that is not finite.

    Args:
        losses: by name, of the newest updates; ``loss`` has one for each of them.
        updates: made so far.

    Raises:
        TrainingError: one is not.
    """
    first = updates - len(losses.get("loss", ())) + 1
    for name, values in losses.items():
        for place, value in enumerate(values):
            if not math.isfinite(value):
                number = f"{first + place}" if name == "loss" else f"{first} to {updates}"
                raise TrainingError(f"update {number}: {name} = {value}: must be finite")


def check_weights(optimizer: torch.optim.Optimizer, updates: int) -> None:
    """Stop at weights that are not finite, or larger than those of networks that learn.

    A gradient that is not finite shows here as well: it goes into the weights or into the
    optimizer's means, which then stop every weight.

    Args:
        optimizer: of all weights.
        updates: made so far.

    Raises:
        TrainingError: there are such weights or means.
    """
    weights = [one.detach() for group in optimizer.param_groups for one in group["params"]]
    means = [
        value
        for state in optimizer.state.values()
        for value in state.values()
        if isinstance(value, Tensor)
    ]
    # All at once: to read each is to wait for a GPU as often.
    device = weights[0].device
    largest = torch.stack(
        [torch.linalg.vector_norm(one, math.inf).to(device) for one in [*weights, *means]]
    ).tolist()
    for value in largest[: len(weights)]:
        if not value <= MAX_WEIGHT:
            raise TrainingError(
                f"update {updates}: the largest weight is {value:g}: must be at most {MAX_WEIGHT:g}"
            )
    for value in largest[len(weights) :]:
        if not math.isfinite(value):
            raise TrainingError(
                f"update {updates}: a mean of the gradients is {value}: must be finite"
            )


def explain_divergence(error: TrainingError, optimizer: OptimizerConfig) -> TrainingError:
    """The same with what may help."""
    rates = {name: value for name, value in optimizer if name.endswith("learning_rate")}
    tried = {**rates, "max_gradient_norm": optimizer.max_gradient_norm}
    fields = ", ".join(f"optimizer.{name} = {value}" for name, value in tried.items())
    return TrainingError(
        f"{error}; the training diverges, and would again if it were resumed: begin another with "
        f"a lower step size or gradient norm, now {fields}; the saved models are from before"
    )


class IdleWatch:
    """Ends a training in which nobody acts.

    Args:
        scenario: in which it collects.
    """

    def __init__(self, scenario: Scenario) -> None:
        self.scenario = scenario
        self.time = 0.0
        """[s] Of every road, since an agent acted."""
        self.has_commands = False
        """In that time."""

    def note(self, batch: TensorDictBase, num_transitions: int) -> None:
        """Look at a collected batch.

        Args:
            batch: (..., T), of all roads.
            num_transitions: of the group that learns.

        Raises:
            TrainingError: nobody has acted for too long.
        """
        if num_transitions:
            self.time, self.has_commands = 0.0, False
            return
        num_steps = batch.shape[-1]
        num_roads = batch.numel() // num_steps
        self.time += num_steps * self.scenario.time_step
        self.has_commands |= bool(batch[CHANGER.group, "mask"].any())
        if self.time >= max(IDLE_TIME, IDLE_ROAD_TIME / num_roads):
            raise TrainingError(
                f"in {self.time:.0f} s on {num_roads} roads there was no transition: {self._why()}"
            )

    def _why(self) -> str:
        scenario = self.scenario
        if self.has_commands:
            return (
                "vehicles are commanded, but none engages; in this traffic gap.rule = "
                f"{scenario.gap.rule} accepts no gap (gap.safe_braking, gap.minimum_gap, "
                "gap.time_gap), or no follower is paired"
            )
        return (
            f"no vehicle is commanded; command.probability = {scenario.command.probability:g} may "
            f"be too low, or horizon = {scenario.horizon} too short to reach command.position"
        )


@contextmanager
def ending(folder: Path) -> Iterator[None]:
    """Where a run fails, end the program with status 1 and one line on stderr.

    Args:
        folder: from which the run can be resumed.
    """
    try:
        yield
    except (WorkerError, OSError, FilmError) as error:
        sys.exit(
            f"error: {_in_one_line(error)}; continue from the last training state: resume={folder}"
        )
    except (TrainingError, ConfigError, ScenarioError, CheckpointError) as error:
        sys.exit(f"error: {_in_one_line(error)}")
    except KeyboardInterrupt:
        print(  # noqa: T201
            f"interrupted at once; continue from the last training state: resume={folder}",
            file=sys.stderr,
        )
        sys.exit(STATUS_INTERRUPTED)


def _in_one_line(error: Exception) -> str:
    return " ".join(str(error).split())
