"""One group's learning: what it is made of, how far it is, and the loop."""

import shutil
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np
import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from tqdm import tqdm

from marl_lanes.envs.batched import LaneChangeEnv
from marl_lanes.extras import need
from marl_lanes.files import write_json
from marl_lanes.naf.checkpoint import CheckpointError, PolicyNetwork
from marl_lanes.training.algorithms.algorithm import Algorithm
from marl_lanes.training.checkpoint import save_checkpoint
from marl_lanes.training.collectors import LocalCollector, MakeCollector
from marl_lanes.training.config import LearnerConfig
from marl_lanes.training.experience import Experience
from marl_lanes.training.failures import (
    IdleWatch,
    TrainingError,
    check_losses,
    check_weights,
    explain_divergence,
)
from marl_lanes.training.interruptions import note_interruptions
from marl_lanes.training.resume import read_state, restore_state, save_state
from marl_lanes.training.run_folder import (
    BUFFER_FOLDER,
    FINAL_MODEL,
    STATE_FILE,
    RunFolder,
)
from marl_lanes.training.timing import Split, TimedPolicy, split_time
from marl_lanes.training.torch_settings import training_settings
from marl_lanes.training.transitions import finished_maneuvers

EvaluateModel = Callable[[PolicyNetwork, Path | None], Mapping[str, Any]]
"""What a network achieves as it is: metrics by name, numbers or None. The first road is recorded
in the file, if there is a path."""


class Learner:
    """One group of agents that learns to drive, while the others keep their policies.

    It needs a run folder before it can train: ``begin`` a new one or ``resume`` an old one.

    Args:
        config: how it learns.
        env: that it collects in, or the pattern of the workers' environments.
        algorithm: its algorithm. Seed torch's generator before you make it.
        others: policies of other groups, modules that write their actions.
        make_collector: in this process, or in others. What it collects in is part of the training
            state.

    Raises:
        MissingExtraError: saved models are to be recorded, and pyarrow is not installed.
    """

    run: RunFolder
    experience: Experience

    def __init__(
        self,
        config: LearnerConfig,
        env: LaneChangeEnv,
        algorithm: Algorithm,
        *,
        others: Sequence[TensorDictModuleBase] = (),
        make_collector: MakeCollector = LocalCollector,
    ) -> None:
        if config.evaluation.record:
            need("pyarrow", "view")
        self.config = config
        self.env = env
        self.algorithm = algorithm
        self.group = algorithm.group
        self.policy = TimedPolicy(*others, algorithm.policy)
        self.collector = make_collector(env, self.policy, config.collector.steps_per_batch)
        self.counters = defaultdict[str, float](float)
        """transitions, updates, saved (models), and seconds by activity."""
        self.idle = IdleWatch(env.scenario)

    @property
    def transitions(self) -> int:
        """Transitions collected so far."""
        return int(self.counters["transitions"])

    @property
    def seconds(self) -> dict[str, float]:
        """Seconds by activity."""
        return {key: round(value, 2) for key, value in self.counters.items() if "_" in key}

    @property
    def split(self) -> Split:
        """Time for each transition by activity, evaluations and saving left out."""
        return split_time(self.counters, self.transitions)

    @property
    def memory(self) -> dict[str, float]:
        """Bytes of an environment and of a transition in the replay buffer."""
        # A step that is not taken has the form of one.
        step = self.env.fake_tensordict()
        step[self.group, "acting"] = torch.ones_like(step[self.group, "acting"])
        row = self.algorithm.take_in(step.unsqueeze(-1))[:1]
        # The buffer adds the row's index.
        index = torch.int64.itemsize
        return {
            "bytes_per_environment": self.env.simulator.bytes_per_environment,
            "bytes_per_stored_transition": row.bytes() + index,
        }

    def _make_experience(self, folder: Path) -> Experience:
        size = self.memory["bytes_per_stored_transition"]
        return self.algorithm.make_experience(folder / BUFFER_FOLDER, size)

    def begin(self, folder: Path, keep_inputs: Callable[[], object] | None = None) -> None:
        """Start in a new or empty folder, and write the first training state. An error empties it.

        Args:
            folder: of the run.
            keep_inputs: writes what a resumed run needs besides, before the training state.

        Raises:
            ConfigError: it holds something, another process is at work in it, or its disk is too
                small for the replay buffer.
            OSError: it cannot be written.
        """
        evaluated = self.config.evaluation.metrics
        self.run = RunFolder(folder, self.algorithm.columns, evaluated=evaluated)
        try:
            if keep_inputs is not None:
                keep_inputs()
            self.experience = self._make_experience(folder)
            self.save()
        except BaseException:
            self.run.discard()
            raise

    def resume(self, folder: Path) -> None:
        """Go on from the training state in the folder.

        Raises:
            CheckpointError: there is none, or it is damaged, or of another run.
            ConfigError: another process is at work in the folder.
        """
        path = folder / STATE_FILE
        content = read_state(path)
        counters, extents = content.get("counters"), content.get("tables")
        if not isinstance(counters, dict) or not isinstance(extents, dict):
            raise CheckpointError(f"training state {path}: counters and tables must be there")
        self.counters.update(counters)
        self.run = RunFolder(
            folder,
            self.algorithm.columns,
            evaluated=self.config.evaluation.metrics,
            extents=extents,
            until=self.transitions,
        )
        try:
            self.experience = self._make_experience(folder)
            restore_state(
                path,
                content,
                loss=self.algorithm.loss,
                optimizer=self.algorithm.optimizer,
                experience=self.experience,
                collector=self.collector,
            )
        except BaseException:
            # The lock, too: another process may go on.
            self.run.close()
            raise

    def save(self) -> None:
        """Write the training state."""
        save_state(
            self.run.state,
            counters=dict(self.counters),
            tables=self.run.take_extents(),
            loss=self.algorithm.loss,
            optimizer=self.algorithm.optimizer,
            experience=self.experience,
            collector=self.collector,
        )

    @contextmanager
    def timed(self, activity: str) -> Iterator[None]:
        """Add the seconds that the block takes to the activity's."""
        start = time.perf_counter()
        yield
        self.counters[f"seconds_{activity}"] += time.perf_counter() - start

    def collect(self) -> TensorDictBase:
        """The next batch of steps."""
        counters = self.counters
        before, simulating, acting = (
            counters["seconds_collecting"],
            self.env.seconds,
            self.policy.seconds,
        )
        with self.timed("collecting"):
            self.algorithm.refresh_policy()
            batch = self.collector.next()
        if self.collector.is_elsewhere:
            # What their time goes into is not known here.
            counters["seconds_waiting"] += counters["seconds_collecting"] - before
        else:
            counters["seconds_simulating"] += self.env.seconds - simulating
            counters["seconds_acting"] += self.policy.seconds - acting
        return batch

    def update(self, number: int) -> dict[str, Tensor]:
        """Make ``number`` updates on batches of experience.

        Returns:
            the losses by name, (number,) or fewer, on the device: the call does not wait for a GPU.
        """
        losses = defaultdict[str, list[Tensor]](list)
        for batch in self.experience.draw(number):
            self.counters["updates"] += 1
            found = self.algorithm.take_step(batch, int(self.counters["updates"]))
            for name, loss in found.items():
                losses[name].append(loss)
        return {name: torch.stack(values) for name, values in losses.items()}

    def learn(self, batch: TensorDictBase) -> None:
        """Store a collected batch, make the updates that are due, log both."""
        with self.timed("storing"):
            transitions = self.algorithm.take_in(batch)
            self.experience.extend(transitions)
            self.counters["transitions"] += len(transitions)
            self.idle.note(batch, len(transitions))
        with self.timed("learning"):
            updates = int(self.counters["updates"])
            losses = self.update(self.experience.num_due(self.transitions, updates))
            found = {name: values.tolist() for name, values in losses.items()}
            self.check(found)
        with self.timed("logging"):
            self.log(batch, found)

    def check(self, losses: Mapping[str, Sequence[float]]) -> None:
        """Look at a round of updates, before its weights act or are saved.

        Raises:
            TrainingError: a loss, a weight or a mean of the gradients says that it diverges.
        """
        if losses:
            updates = int(self.counters["updates"])
            try:
                check_losses(losses, updates)
                check_weights(self.algorithm.optimizer, updates)
            except TrainingError as error:
                raise explain_divergence(error, self.config.optimizer) from None

    def log(self, batch: TensorDictBase, losses: Mapping[str, Sequence[float]]) -> None:
        """One row of metrics, one for every maneuver that ended."""
        returns, outcomes = finished_maneuvers(batch, self.group)
        means = {name: float(np.mean(values)) for name, values in losses.items()}
        learned = {**self.algorithm.schedules(), **means}
        row = {
            "updates": int(self.counters["updates"]),
            **{name: learned.get(name, "") for name in self.algorithm.columns},
            "num_ended": len(returns),
            "mean_return": float(returns.mean()) if len(returns) else "",
        }
        self.run.metrics.append((self.transitions, *row.values()))
        self.run.maneuvers.append(
            *(
                (self.transitions, *pair)
                for pair in zip(returns.tolist(), outcomes.tolist(), strict=True)
            )
        )
        self.run.log("train", row, self.transitions)

    def save_model(self, name: str, evaluate_model: EvaluateModel) -> None:
        """Write the policy and what it achieves."""
        path = self.run.checkpoints / name
        network = self.algorithm.network
        save_checkpoint(path, network, self.env.scenario.name, self.transitions)
        recorded = self.run.trajectory(name) if self.config.evaluation.record else None
        summary = evaluate_model(network, recorded)
        for metric, value in summary.items():
            if isinstance(value, float) and not isfinite(value):
                raise TrainingError(f"{name}: {metric} = {value}: must be finite, or null")
        row = [summary[key] for key in self.config.evaluation.metrics]
        self.run.evaluations.append(
            (self.transitions, name, *("" if value is None else value for value in row))
        )
        self.run.log("saved_model", summary, self.transitions)
        self.counters["saved"] += 1

    def train(self, evaluate_model: EvaluateModel) -> bool:
        """Collect and learn until all transitions are made; write the final model.

        With a criterion that is the best of the saved models, the first of which is saved before
        any transition and the last one at the end. The network itself is the last one.

        Ctrl-C (or SIGTERM) ends it after the batch at hand. Either way the training state is
        written.

        Args:
            evaluate_model: of every saved model.

        Returns:
            whether the training is over; False when it was interrupted.

        Raises:
            WorkerError: a worker has died; the training state is the last one that was written.
            TrainingError: it diverges, or nobody acts; likewise.
        """
        total = self.config.collector.total_transitions
        interval = self.config.evaluation.save_interval
        criterion = self.config.evaluation.criterion
        with (
            training_settings(self.algorithm.device),
            note_interruptions() as interrupted,
            tqdm(
                total=total, initial=self.transitions, unit="tr", unit_scale=True, desc="training"
            ) as bar,
        ):
            if criterion is not None and not self.counters["saved"]:
                self._save_step(evaluate_model)
            while self.transitions < total and not interrupted:
                before = self.transitions
                with self.timed("training"):
                    self.algorithm.anneal(self.transitions)
                    self.learn(self.collect())
                    bar.update(self.transitions - before)
                is_last = self.transitions >= total and criterion is not None
                if self.transitions // interval > before // interval or is_last:
                    self._save_step(evaluate_model)
        self.save()
        if self.transitions < total:
            return False
        if criterion is None:
            with self.timed("evaluating"):
                self.save_model(FINAL_MODEL, evaluate_model)
        else:
            self.run.choose_model(criterion)
        write_json(self.run.times, self.seconds)
        return True

    def _save_step(self, evaluate_model: EvaluateModel) -> None:
        """Save the model as it is now, and the training state."""
        with self.timed("evaluating"):
            self.save_model(f"step_{self.transitions:09d}.pt", evaluate_model)
            self.save()

    def close(self) -> None:
        """Release the collector, the logs, and the files of the replay buffer."""
        self.collector.shutdown()
        # While the folder is locked: the next process makes its own.
        shutil.rmtree(self.run.path / BUFFER_FOLDER, ignore_errors=True)
        self.run.close()
