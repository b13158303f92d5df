"""One group's learning: what it is made of, how far it is, and the loop."""

import copy
import shutil
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor, nn
from torch.nn.utils import clip_grad_norm_
from torchrl.modules import AdditiveGaussianModule
from torchrl.objectives import HardUpdate
from tqdm import tqdm

from marl_lanes.envs.batched import LaneChangeEnv
from marl_lanes.files import write_json
from marl_lanes.naf.joined import join_parameters
from marl_lanes.naf.loss import NAFLoss
from marl_lanes.naf.network import NAFNetwork
from marl_lanes.naf.updater import ForeachSoftUpdate
from marl_lanes.traffic.roles.changer import CHANGER
from marl_lanes.training.checkpoint import save_checkpoint
from marl_lanes.training.collectors import LocalCollector, MakeCollector
from marl_lanes.training.config import LearnerConfig
from marl_lanes.training.interruptions import note_interruptions
from marl_lanes.training.replay import Replay
from marl_lanes.training.resume import read_state, restore_state, save_state
from marl_lanes.training.run_folder import (
    EVALUATED,
    FINAL_MODEL,
    REPLAY_FOLDER,
    STATE_FILE,
    RunFolder,
    check_empty,
)
from marl_lanes.training.timing import Split, TimedPolicy, split_time
from marl_lanes.training.transitions import (
    CPU,
    LivePolicy,
    finished_maneuvers,
    live_transitions,
    send,
)

ROWS_AT_ONCE = 32_768
"""Rows read from the replay buffer together, for as many updates as they make."""

EvaluateModel = Callable[[NAFNetwork], Mapping[str, Any]]
"""What a network achieves as it is: metrics by name, numbers or None."""


class Learner:
    """A network that learns to drive one group of agents, while the others keep their policies.

    It needs a run folder before it can train: ``begin`` a new one or ``resume`` an old one.

    Args:
        config: how it learns.
        env: that it collects in, or the pattern of the workers' environments.
        network: of the group; moved to the device, and changed in place. Random numbers are torch's
            own: seed them before.
        group: whose network it is.
        others: policies of other groups, modules that write their actions.
        evaluated: the metrics in the table of the saved models, the criterion among them.
        make_collector: in this process, or in others. What it collects in is part of the training
            state.
        device: where the network learns.
        acting_device: where it drives: there, too, or on the CPU, as in workers. What it sees and
            does is on the CPU.
    """

    run: RunFolder
    replay: Replay

    def __init__(
        self,
        config: LearnerConfig,
        env: LaneChangeEnv,
        network: NAFNetwork,
        *,
        group: str = CHANGER.group,
        others: Sequence[TensorDictModuleBase] = (),
        evaluated: Sequence[str] = EVALUATED,
        make_collector: MakeCollector = LocalCollector,
        device: torch.device = CPU,
        acting_device: torch.device = CPU,
    ) -> None:
        self.config = config
        self.env = env
        self.network = network.to(device)
        self.device = device
        self.group = group
        self.evaluated = tuple(evaluated)
        # One tensor for what learns together: the optimiser's work is mostly a cost for each.
        parts = [*network.factor_logits.parameters(), *network.value.parameters()]
        self.joined = [join_parameters(part) for part in (parts, list(network.mu.parameters()))]
        self.gradients = [block.grad for block in self.joined if block.grad is not None]
        rates: dict[float, list[nn.Parameter]] = {}
        steps = config.optimizer.learning_rate, config.optimizer.mu_learning_rate
        for block, rate in zip(self.joined, steps, strict=True):
            rates.setdefault(rate, []).append(block)
        self.rates = tuple(rates)
        self.loss = NAFLoss(network)
        self.loss.make_value_estimator(gamma=config.loss.gamma)
        if config.loss.target_update == "soft":
            self.target_updater = ForeachSoftUpdate(self.loss, tau=config.loss.tau)
        else:
            # Its interval counts the calls in between, of which there are none.
            self.target_updater = HardUpdate(self.loss, value_network_update_interval=0)
        self.optimizer = torch.optim.Adam(
            [{"params": blocks, "lr": rate} for rate, blocks in rates.items()], fused=True
        )
        self.compute_loss = torch.compile(self.loss) if config.optimizer.compile else self.loss
        self.noise = AdditiveGaussianModule(
            spec=env.full_action_spec,
            action_key=(group, "action"),
            sigma_init=float(config.exploration.initial_sigma),
            sigma_end=float(config.exploration.final_sigma),
        )
        # Sigma is a share of the half range, whatever the action's unit.
        self.noise.std = network.box.half_range.to(CPU, copy=True)
        self.noise.std[1:] *= config.exploration.longitudinal_factor
        # Elsewhere it drives with a copy, which each batch begins with.
        is_same = acting_device == device
        self.actor = network if is_same else copy.deepcopy(network).to(acting_device)
        policy = LivePolicy(
            self.actor.policy().module, network.action_dim, group, device=acting_device
        )
        self.policy = TimedPolicy(*others, policy, self.noise)
        self.collector = make_collector(env, self.policy, config.collector.steps_per_batch)
        self.counters = defaultdict[str, float](float)
        """transitions, updates, saved (models), and seconds by activity."""

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
        row = live_transitions(step, self.group)[:1]
        # The buffer adds the row's index.
        index = torch.int64.itemsize
        return {
            "bytes_per_environment": self.env.simulator.bytes_per_environment,
            "bytes_per_stored_transition": row.bytes() + index,
        }

    def _make_replay(self, folder: Path) -> Replay:
        size = self.memory["bytes_per_stored_transition"]
        return Replay(self.config.replay, folder / REPLAY_FOLDER, size, self.device)

    def begin(self, folder: Path) -> None:
        """Start in a new or empty folder.

        Raises:
            ConfigError: it holds something, or its disk is too small for the replay buffer.
        """
        check_empty(folder)
        self.replay = self._make_replay(folder)
        self.run = RunFolder(folder, evaluated=self.evaluated)
        self.save()

    def resume(self, folder: Path) -> None:
        """Go on from the training state in the folder.

        Raises:
            CheckpointError: there is none, or it cannot be read.
        """
        content = read_state(folder / STATE_FILE)
        self.counters.update(content["counters"])
        self.replay = self._make_replay(folder)
        restore_state(
            content,
            loss=self.loss,
            optimizer=self.optimizer,
            replay=self.replay,
            collector=self.collector,
        )
        self.run = RunFolder(folder, until=self.transitions, evaluated=self.evaluated)

    def save(self) -> None:
        """Write the training state."""
        save_state(
            self.run.state,
            counters=dict(self.counters),
            loss=self.loss,
            optimizer=self.optimizer,
            replay=self.replay,
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
            if self.actor is not self.network:
                self.actor.load_state_dict(self.network.state_dict())
            batch = self.collector.next()
        counters["seconds_simulating"] += self.env.seconds - simulating
        counters["seconds_acting"] += self.policy.seconds - acting
        if self.collector.places:
            # What the workers' time goes into is not known here.
            counters["seconds_waiting"] += counters["seconds_collecting"] - before
        return batch

    def anneal(self) -> None:
        """Set noise, step sizes and stage for the transitions to come."""
        exploration = self.config.exploration
        share = min(1.0, self.transitions / max(1, exploration.annealing_transitions))
        sigma = exploration.initial_sigma
        self.noise.sigma.fill_(sigma + share * (exploration.final_sigma - sigma))
        optimizer = self.config.optimizer
        stage_one = optimizer.pretraining_transitions
        stage_two = max(1, self.config.collector.total_transitions - stage_one)
        share = min(1.0, max(0, self.transitions - stage_one) / stage_two)
        for group, rate in zip(self.optimizer.param_groups, self.rates, strict=True):
            group["lr"] = rate * (1.0 - share * (1.0 - optimizer.final_rate))
        is_stage_one = self.transitions < stage_one
        # Adam passes over what has no gradient; a zero one it would count as a step.
        self.joined[1].grad = None if is_stage_one else self.gradients[1]
        self.network.mu_frozen = is_stage_one
        self.loss.value_network.mu_frozen = is_stage_one

    def update(self, number: int) -> Tensor:
        """So many gradient steps on batches from the replay buffer, and the target's.

        Returns:
            the losses, (number,), on the device: the call does not wait for a GPU.
        """
        size = self.config.replay.batch_size
        at_once = max(1, ROWS_AT_ONCE // size)
        losses: list[Tensor] = []
        while (left := number - len(losses)) > 0:
            rows = self.replay.sample(min(left, at_once))
            if self.config.replay.storage == "memmap":
                rows = send(rows, self.device)
            losses += [self._take_step(batch) for batch in rows.unbind(0)]
        return torch.stack(losses) if losses else torch.empty(0)

    def _take_step(self, batch: TensorDictBase) -> Tensor:
        config = self.config
        for gradient in self.gradients:
            gradient.zero_()
        loss: Tensor = self.compute_loss(batch)["loss"]
        loss.backward()
        if config.optimizer.max_gradient_norm is not None:
            clip_grad_norm_(self.joined, config.optimizer.max_gradient_norm, foreach=True)
        self.optimizer.step()
        self.counters["updates"] += 1
        if int(self.counters["updates"]) % config.loss.target_interval == 0:
            self.target_updater.step()
        return loss.detach()

    def learn(self, batch: TensorDictBase) -> None:
        """Store a collected batch, make the updates that are due, log both."""
        with self.timed("storing"):
            transitions = live_transitions(batch, self.group)
            on_device = self.config.replay.storage == "memory"
            self.replay.extend(send(transitions, self.device) if on_device else transitions)
            self.counters["transitions"] += len(transitions)
        with self.timed("learning"):
            config = self.config
            start = config.replay.warmup_transitions
            due = max(0, self.transitions - start) / config.optimizer.transitions_per_update
            losses = self.update(int(due) - int(self.counters["updates"]))
        with self.timed("logging"):
            self.log(batch, losses)

    def log(self, batch: TensorDictBase, losses: Tensor) -> None:
        """One row of metrics, one for every maneuver that ended."""
        returns, outcomes = finished_maneuvers(batch, self.group)
        row = {
            "updates": int(self.counters["updates"]),
            "stage": 1 if self.network.mu_frozen else 2,
            "loss": float(np.mean(losses.tolist())) if len(losses) else "",
            "sigma": float(self.noise.sigma),
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
        save_checkpoint(path, self.network, self.env.scenario.name, self.transitions)
        summary = evaluate_model(self.network)
        row = [summary[key] for key in self.evaluated]
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
        """
        total = self.config.collector.total_transitions
        interval = self.config.evaluation.save_interval
        criterion = self.config.evaluation.criterion
        with (
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
                    self.anneal()
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
        self.run.close()
        shutil.rmtree(self.run.path / REPLAY_FOLDER, ignore_errors=True)
