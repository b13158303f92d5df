"""A training of the lane changers from its configuration to its report, for any algorithm."""

import sys
from collections.abc import Callable, Mapping
from importlib.metadata import version
from pathlib import Path
from platform import python_version
from typing import Any

import torch
from tqdm import tqdm

from marl_lanes.envs.batched import LaneChangeEnv
from marl_lanes.evaluation.figures import draw_maneuver, draw_training
from marl_lanes.evaluation.headlines import estimate_headlines
from marl_lanes.evaluation.intervals import CONFIDENCE
from marl_lanes.evaluation.maneuver_table import tabulate, write_maneuvers
from marl_lanes.evaluation.metrics import evaluate, measure_each, summarise
from marl_lanes.evaluation.rollout import check_episodes, run_maneuvers
from marl_lanes.evaluation.tables import format_summary
from marl_lanes.files import write_json, write_text
from marl_lanes.naf.checkpoint import PolicyNetwork, greedy_policy
from marl_lanes.report.page import write_report
from marl_lanes.scenario import Scenario, load_scenario
from marl_lanes.training.algorithms.algorithm import Algorithm
from marl_lanes.training.checkpoint import load_policy
from marl_lanes.training.collectors import WorkerError
from marl_lanes.training.config import ChangersConfig, ConfigError, write_config
from marl_lanes.training.learner import Learner
from marl_lanes.training.run_folder import (
    COMMAND_FILE,
    EVALUATION_FILE,
    FINAL_MANEUVERS_FILE,
    FINAL_MODEL,
    RunFolder,
    check_empty,
)
from marl_lanes.training.timing import format_split
from marl_lanes.training.transitions import CPU
from marl_lanes.training.workers import choose_collector

PACKAGES = ("marl-lanes", "torch", "torchrl", "tensordict", "numba", "numpy")
"""The packages whose versions the evaluation names."""

MakeAlgorithm = Callable[[LaneChangeEnv, Scenario, torch.device, torch.device], Algorithm]
"""Makes an algorithm from the environment that collects, the scenario, and the devices where it
learns and acts. Torch's generator is seeded before."""


def start(
    config: ChangersConfig, make_algorithm: MakeAlgorithm, command: str
) -> tuple[Learner, Scenario]:
    """Begin a new run, or resume one. After an error no file is left behind.

    Args:
        config: of the run.
        make_algorithm: what the learner is made of.
        command: the command line that begins the run; a resumed run keeps its own.

    Raises:
        ConfigError, ScenarioError, CheckpointError: the run cannot be made.
    """
    torch.set_num_threads(config.num_threads)
    scenario = load_scenario(config.scenario)
    check_episodes(scenario)
    env = LaneChangeEnv(
        scenario,
        config.collector.num_envs // config.num_workers,
        seed=config.seed,
        overrides=config.training_overrides,
    )
    if env.scenario.command.probability == 0.0:
        raise ConfigError("training_overrides: command.probability = 0: must be above 0")
    torch.manual_seed(config.seed)
    folder = Path(config.output)
    if config.resume is None:
        check_empty(folder)
    device = torch.device(config.device)
    acting_device = device if config.collector.kind == "single" else CPU
    learner = Learner(
        config,
        env,
        make_algorithm(env, scenario, device, acting_device),
        make_collector=choose_collector(config.collector, config.num_workers, config.ray.address),
    )
    try:
        if config.resume is not None:
            learner.resume(folder)
        else:
            learner.begin(folder)
            write_config(learner.run.config, config)
            write_text(learner.run.path / COMMAND_FILE, f"{command}\n")
    except BaseException:
        learner.collector.shutdown()
        raise
    return learner, scenario


def run(learner: Learner, config: ChangersConfig, scenario: Scenario) -> None:
    """Train until the end or an interruption, and report. If a worker dies, the program ends."""
    try:
        _train(learner, config, scenario)
    except WorkerError as error:
        sys.exit(f"error: {error}; continue from the last saved model: resume={learner.run.path}")
    finally:
        learner.close()


def _train(learner: Learner, config: ChangersConfig, scenario: Scenario) -> None:
    for index, place in enumerate(learner.collector.places):
        print(f"worker {index}: {place}", file=sys.stderr)

    def evaluate_model(network: PolicyNetwork) -> Mapping[str, Any]:
        settings = config.evaluation
        maneuvers = run_maneuvers(
            scenario,
            greedy_policy(network),
            settings.num_maneuvers,
            seed=settings.saved_models_seed,
        )
        return evaluate(maneuvers, scenario, with_optimum=False)

    if not learner.train(evaluate_model):
        print(f"interrupted; continue with resume={learner.run.path}")
        return
    summary = _report(learner, config, scenario)
    print(f"run folder: {learner.run.path}")
    print(format_summary({**learner.seconds, **learner.memory, **summary}))
    print(f"time of the training, without evaluating and saving:\n{format_split(learner.split)}")


def _report(learner: Learner, config: ChangersConfig, scenario: Scenario) -> dict[str, Any]:
    """Evaluate the final policy; write its numbers, the figures and the report."""
    run = learner.run
    settings = config.evaluation
    number = settings.final_num_maneuvers
    network = load_policy(run.checkpoints / FINAL_MODEL, scenario).network
    with tqdm(total=2 * number, unit="maneuver", desc="evaluating") as bar:
        maneuvers = run_maneuvers(
            scenario,
            greedy_policy(network),
            number,
            seed=settings.seed,
            progress=lambda count: bar.update(min(count, number) - bar.n),
        )
        measured, no_optimum = measure_each(
            maneuvers, scenario, progress=lambda count: bar.update(number + count - bar.n)
        )
    summary = summarise(measured, no_optimum=no_optimum)
    write_json(
        run.path / EVALUATION_FILE,
        {
            "scenario": scenario.name,
            "policy": f"checkpoints/{FINAL_MODEL}",
            "seed": settings.seed,
            **summary,
            "confidence": CONFIDENCE,
            "intervals": estimate_headlines(measured, [maneuver.env for maneuver in maneuvers]),
            "versions": {name: version(name) for name in PACKAGES} | {"python": python_version()},
        },
    )
    write_maneuvers(run.path / FINAL_MANEUVERS_FILE, tabulate(maneuvers, measured, scenario))
    stage_one = learner.algorithm.pretraining_transitions
    draw_training(run.path, stage_one, summary["mean_optimal_return"])
    _draw_first_and_last(run, scenario, settings.seed)
    write_report(run.path)
    return summary


def _draw_first_and_last(run: RunFolder, scenario: Scenario, seed: int) -> None:
    """Figure 8: the first and the last saved model on the same maneuver."""
    saved = sorted(run.checkpoints.glob("step_*.pt"))
    paths = (saved[0] if saved else run.checkpoints / FINAL_MODEL, run.checkpoints / FINAL_MODEL)
    loaded = [load_policy(path, scenario) for path in paths]
    first, last = (
        run_maneuvers(scenario, greedy_policy(model.network), 1, seed=seed)[0] for model in loaded
    )
    labels = (f"{loaded[0].transitions:,} transitions", f"{loaded[1].transitions:,} transitions")
    draw_maneuver(run.figures / "first_and_last", first, last, labels, scenario)
