"""Train the shared NAF policy of all lane changers, evaluate it, write its report.

python agents/naf/train.py [recipe=fast|paper] [scenario=NAME] [network.mu=paper|damped|mlp]
    [seed=N] [output=DIR] [resume=RUN] [any field of the config]
"""

import signal
import sys
import time
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, cast

import hydra
import numpy as np
import torch
from omegaconf import DictConfig, OmegaConf
from tensordict import TensorDictBase
from tensordict.nn import TensorDictSequential
from torch.nn.utils import clip_grad_norm_
from torchrl.collectors import Collector
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
from torchrl.modules import AdditiveGaussianModule
from torchrl.objectives import HardUpdate, SoftUpdate
from tqdm import tqdm

from marl_lanes import LaneChangeEnv, NAFLoss, Scenario, load_scenario
from marl_lanes.evaluation.figures import draw_maneuver, draw_training
from marl_lanes.evaluation.metrics import evaluate
from marl_lanes.evaluation.rollout import check_episodes, run_maneuvers
from marl_lanes.training.checkpoint import (
    greedy_policy,
    load_checkpoint,
    make_network,
    save_checkpoint,
)
from marl_lanes.training.config import ConfigError, TrainingConfig, check, register
from marl_lanes.training.files import write_atomically, write_json
from marl_lanes.training.resume import read_state, restore_state, save_state
from marl_lanes.training.run_folder import FINAL_MODEL, RunFolder
from marl_lanes.training.transitions import LivePolicy, finished_maneuvers, live_transitions

register()


class Training:
    """One run: what it is made of, and how far it is."""

    run: RunFolder

    def __init__(self, config: TrainingConfig) -> None:
        self.config = config
        self.scenario = load_scenario(config.scenario)
        check_episodes(self.scenario)
        self.env = LaneChangeEnv(
            self.scenario,
            config.collector.num_envs,
            seed=config.seed,
            overrides=config.training_overrides,
        )
        if self.env.scenario.command.probability == 0.0:
            raise ConfigError("training_overrides: command.probability = 0: must be above 0")
        torch.manual_seed(config.seed)
        self.network = make_network(
            self.scenario, config.network.mu, list(config.network.hidden_sizes)
        )
        self.loss = NAFLoss(self.network)
        self.loss.make_value_estimator(gamma=config.loss.gamma)
        if config.loss.target_update == "soft":
            self.target_updater = SoftUpdate(self.loss, tau=config.loss.tau)
        else:
            # Its interval counts the calls in between, of which there are none.
            self.target_updater = HardUpdate(self.loss, value_network_update_interval=0)
        rates = {
            self.network.factor_logits: config.optimizer.learning_rate,
            self.network.value: config.optimizer.learning_rate,
            self.network.mu: config.optimizer.mu_learning_rate,
        }
        self.optimizer = torch.optim.Adam(
            [{"params": list(part.parameters()), "lr": rate} for part, rate in rates.items()],
            fused=True,
        )
        self.replay = TensorDictReplayBuffer(
            storage=LazyTensorStorage(config.replay.capacity),
            batch_size=config.replay.batch_size,
        )
        self.noise = AdditiveGaussianModule(
            spec=self.env.full_action_spec,
            action_key=self.env.action_keys[0],
            sigma_init=float(config.exploration.initial_sigma),
            sigma_end=float(config.exploration.final_sigma),
        )
        policy = LivePolicy(self.network.policy().module, self.network.action_dim)
        self.collector = Collector(
            self.env,
            TensorDictSequential(policy, self.noise),
            frames_per_batch=config.collector.num_envs * config.collector.steps_per_batch,
            total_frames=-1,
            track_traj_ids=False,
            auto_register_policy_transforms=False,
        )
        self.counters = defaultdict[str, float](float)
        """transitions, updates, saved (models), and seconds by activity."""

    @property
    def transitions(self) -> int:
        """Transitions collected so far."""
        return int(self.counters["transitions"])

    def restore(self, content: dict[str, Any]) -> None:
        """Go on from a training state."""
        self.counters.update(content["counters"])
        restore_state(
            content, loss=self.loss, optimizer=self.optimizer, replay=self.replay, env=self.env
        )
        # It has looked at its environment when it was built; let it look again.
        self.collector.reset()

    def save(self) -> None:
        """Write the training state."""
        save_state(
            self.run.state,
            counters=dict(self.counters),
            loss=self.loss,
            optimizer=self.optimizer,
            replay=self.replay,
            env=self.env,
        )

    @contextmanager
    def timed(self, activity: str) -> Iterator[None]:
        """Add the seconds that the block takes to the activity's."""
        start = time.perf_counter()
        yield
        self.counters[f"seconds_{activity}"] += time.perf_counter() - start

    def anneal(self) -> None:
        """Set the exploration noise and the stage for the transitions to come."""
        exploration = self.config.exploration
        share = min(1.0, self.transitions / max(1, exploration.annealing_transitions))
        sigma = exploration.initial_sigma
        self.noise.sigma.fill_(sigma + share * (exploration.final_sigma - sigma))
        is_stage_one = self.transitions < self.config.optimizer.pretraining_transitions
        self.network.mu_frozen = is_stage_one
        self.loss.value_network.mu_frozen = is_stage_one

    def update(self) -> float:
        """One gradient step on a batch from the replay buffer, and the target's."""
        self.optimizer.zero_grad(set_to_none=True)
        loss = self.loss(self.replay.sample())["loss"]
        loss.backward()
        if self.config.optimizer.max_gradient_norm is not None:
            clip_grad_norm_(self.network.parameters(), self.config.optimizer.max_gradient_norm)
        self.optimizer.step()
        self.counters["updates"] += 1
        if int(self.counters["updates"]) % self.config.loss.target_interval == 0:
            self.target_updater.step()
        return float(loss.detach())

    def learn(self, batch: TensorDictBase) -> None:
        """Store a collected batch, make the updates that are due, log both."""
        with self.timed("storing"):
            transitions = live_transitions(batch)
            if len(transitions):
                self.replay.extend(transitions)
            self.counters["transitions"] += len(transitions)
        losses = []
        with self.timed("learning"):
            config = self.config
            start = config.replay.warmup_transitions
            due = max(0, self.transitions - start) / config.optimizer.transitions_per_update
            while self.transitions >= start and self.counters["updates"] < int(due):
                losses.append(self.update())
        with self.timed("logging"):
            self.log(batch, losses)

    def log(self, batch: TensorDictBase, losses: list[float]) -> None:
        """One row of metrics, one for every maneuver that ended."""
        returns, outcomes = finished_maneuvers(batch)
        row = {
            "updates": int(self.counters["updates"]),
            "stage": 1 if self.network.mu_frozen else 2,
            "loss": float(np.mean(losses)) if losses else "",
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

    def save_model(self, name: str) -> None:
        """Write the policy and what it achieves in a short evaluation."""
        path = self.run.checkpoints / name
        save_checkpoint(path, self.network, self.scenario.name, self.transitions)
        settings = self.config.evaluation
        maneuvers = run_maneuvers(
            self.scenario, greedy_policy(self.network), settings.num_maneuvers, seed=settings.seed
        )
        summary = evaluate(maneuvers, self.scenario, with_optimum=False)
        row = [summary[key] for key in ("mean_return", "completion_rate", "mean_num_steps")]
        self.run.evaluations.append(
            (self.transitions, name, *("" if value is None else value for value in row))
        )
        self.run.log("saved_model", summary, self.transitions)
        self.counters["saved"] += 1

    def train(self) -> bool:
        """Collect and learn until all transitions are made; False when interrupted before."""
        total = self.config.collector.total_transitions
        interval = self.config.evaluation.save_interval
        batches = iter(self.collector)
        with (
            _interruptions() as interrupted,
            tqdm(
                total=total, initial=self.transitions, unit="tr", unit_scale=True, desc="training"
            ) as bar,
        ):
            while self.transitions < total and not interrupted:
                before = self.transitions
                self.anneal()
                with self.timed("collecting"):
                    batch = cast("TensorDictBase", next(batches))
                self.learn(batch)
                if self.transitions // interval > before // interval:
                    with self.timed("evaluating"):
                        self.save_model(f"step_{self.transitions:09d}.pt")
                        self.save()
                bar.update(self.transitions - before)
        return self.transitions >= total

    def close(self) -> None:
        """Release the collector and the logs."""
        self.collector.shutdown()
        self.run.close()


@contextmanager
def _interruptions() -> Iterator[list[int]]:
    """Let Ctrl-C (and a polite kill) finish the iteration at hand; a second one stops at once."""
    received: list[int] = []

    def note(number: int, frame: Any) -> None:
        if received:
            signal.default_int_handler(number, frame)
        received.append(number)

    previous = {number: signal.signal(number, note) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield received
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)


def report(training: Training) -> dict[str, Any]:
    """Evaluate the final policy, write evaluation.json and the figures."""
    config, scenario, run = training.config, training.scenario, training.run
    number = config.evaluation.final_num_maneuvers
    policy = greedy_policy(training.network)
    with tqdm(total=2 * number, unit="maneuver", desc="evaluating") as bar:
        maneuvers = run_maneuvers(
            scenario,
            policy,
            number,
            seed=config.evaluation.seed,
            progress=lambda count: bar.update(min(count, number) - bar.n),
        )
        summary = evaluate(
            maneuvers, scenario, progress=lambda count: bar.update(number + count - bar.n)
        )
    write_json(
        run.path / "evaluation.json",
        {
            "scenario": scenario.name,
            "policy": f"checkpoints/{FINAL_MODEL}",
            "seed": config.evaluation.seed,
            **summary,
        },
    )
    pretraining = config.optimizer.pretraining_transitions
    draw_training(run.path, pretraining, summary["mean_optimal_return"])
    draw_first_and_last(run, scenario, config.evaluation.seed)
    return summary


def draw_first_and_last(run: RunFolder, scenario: Scenario, seed: int) -> None:
    """Figure 8: the first and the last saved model on the same maneuver."""
    saved = sorted(run.checkpoints.glob("step_*.pt"))
    paths = (saved[0] if saved else run.checkpoints / FINAL_MODEL, run.checkpoints / FINAL_MODEL)
    loaded = [load_checkpoint(path, scenario) for path in paths]
    first, last = (
        run_maneuvers(scenario, greedy_policy(model.network), 1, seed=seed)[0] for model in loaded
    )
    labels = (f"{loaded[0].transitions:,} transitions", f"{loaded[1].transitions:,} transitions")
    draw_maneuver(run.figures / "first_and_last.png", first, last, labels, scenario)


def read_config(given: DictConfig) -> TrainingConfig:
    """The typed configuration; that of the run to resume, where one is named."""
    resume = given.resume
    if resume is not None:
        path = Path(resume) / "config.yaml"
        if not path.is_file():
            raise ConfigError(f"resume = {resume!r}: must be a run folder; it has no config.yaml")
        stored = OmegaConf.merge(OmegaConf.structured(TrainingConfig), OmegaConf.load(path))
        stored.output, stored.resume = resume, resume
        given = cast("DictConfig", stored)
    config = cast("TrainingConfig", OmegaConf.to_object(given))
    check(config)
    return config


def start(config: TrainingConfig) -> Training:
    """A new run, or the one to resume."""
    torch.set_num_threads(config.num_threads)
    folder = Path(config.output)
    # Built before the folder is touched: what is wrong with the config leaves nothing behind.
    training = Training(config)
    if config.resume is not None:
        content = read_state(folder / "resume.pt")
        training.restore(content)
        training.run = RunFolder(folder, until=training.transitions)
        return training
    training.run = RunFolder(folder)
    text = OmegaConf.to_yaml(OmegaConf.structured(config))
    path = training.run.config
    write_atomically(path, lambda temporary: temporary.write_text(text, encoding="utf-8"))
    return training


@hydra.main(version_base="1.3", config_path=".", config_name="config")
def main(given: DictConfig) -> None:
    """Train, evaluate, report."""
    try:
        training = start(read_config(given))
    except (ValueError, OSError) as error:
        sys.exit(f"error: {error}")
    is_complete = training.train()
    training.save()
    if not is_complete:
        training.close()
        print(f"interrupted; continue with resume={training.run.path}")
        return
    with training.timed("evaluating"):
        training.save_model(FINAL_MODEL)
    training.run.evaluations.close()
    seconds = {key: round(value, 2) for key, value in training.counters.items() if "_" in key}
    write_json(training.run.path / "training.json", seconds)
    summary = report(training)
    training.close()
    print(f"run folder: {training.run.path}")
    for name, value in {**seconds, **summary}.items():
        print(f"  {name}: {value:.4g}" if isinstance(value, float) else f"  {name}: {value}")


if __name__ == "__main__":
    main()
