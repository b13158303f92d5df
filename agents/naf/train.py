"""Train the shared NAF policy of all lane changers, evaluate it, write its report.

python agents/naf/train.py [scenario=NAME] [recipe=fast|interactive|paper] [network.mu=NAME]
    [seed=N] [output=DIR] [initial_checkpoint=FILE] [resume=RUN]
    [collector=multi|ray num_workers=N [ray.address=HOST:PORT]] [any field of the config]

A scenario with two actions gets the recipe interactive, others the recipe fast.
"""

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import hydra
import torch
from omegaconf import DictConfig
from tqdm import tqdm

from marl_lanes import LaneChangeEnv, NAFNetwork, Scenario, load_scenario
from marl_lanes.evaluation.figures import draw_maneuver, draw_training
from marl_lanes.evaluation.metrics import evaluate
from marl_lanes.evaluation.rollout import check_episodes, run_maneuvers
from marl_lanes.evaluation.tables import format_summary
from marl_lanes.files import write_json
from marl_lanes.naf.checkpoint import greedy_policy
from marl_lanes.training.checkpoint import load_checkpoint, make_network
from marl_lanes.training.collectors import WorkerError
from marl_lanes.training.config import (
    ConfigError,
    TrainingConfig,
    check,
    check_criterion,
    read_config,
    register,
    write_config,
)
from marl_lanes.training.learner import Learner
from marl_lanes.training.run_folder import EVALUATED, FINAL_MODEL, RunFolder, check_empty
from marl_lanes.training.timing import format_split
from marl_lanes.training.transitions import CPU
from marl_lanes.training.workers import choose_collector

register("training_schema", TrainingConfig)


@hydra.main(version_base="1.3", config_path=".", config_name="config")
def main(given: DictConfig) -> None:
    """Train, evaluate, report."""
    try:
        config = read(given)
        learner, scenario = start(config)
    except (ValueError, OSError) as error:
        sys.exit(f"error: {error}")

    try:
        run(learner, config, scenario)
    except WorkerError as error:
        sys.exit(f"error: {error}; continue from the last saved model: resume={learner.run.path}")
    finally:
        learner.close()


def run(learner: Learner, config: TrainingConfig, scenario: Scenario) -> None:
    """Train to the end, or until it is interrupted; report."""
    for index, place in enumerate(learner.collector.places):
        print(f"worker {index}: {place}", file=sys.stderr)

    def evaluate_model(network: NAFNetwork) -> Mapping[str, Any]:
        settings = config.evaluation
        policy = greedy_policy(network)
        maneuvers = run_maneuvers(scenario, policy, settings.num_maneuvers, seed=settings.seed + 1)
        return evaluate(maneuvers, scenario, with_optimum=False)

    if not learner.train(evaluate_model):
        print(f"interrupted; continue with resume={learner.run.path}")
        return
    summary = report(learner, config, scenario)
    print(f"run folder: {learner.run.path}")
    print(format_summary({**learner.seconds, **learner.memory, **summary}))
    print(f"time of the training, without evaluating and saving:\n{format_split(learner.split)}")


def read(given: DictConfig) -> TrainingConfig:
    """The configuration; the cluster may be another one when a run goes on."""
    config = read_config(given, TrainingConfig)
    if given.ray.address is not None:
        config.ray.address = given.ray.address
    return config


def start(config: TrainingConfig) -> tuple[Learner, Scenario]:
    """A new run, or the one to resume; what is wrong with the config leaves nothing behind."""
    check(config)
    check_criterion(config, EVALUATED)
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
    learner = Learner(
        config,
        env,
        start_network(config, scenario),
        make_collector=choose_collector(config.collector, config.num_workers, config.ray.address),
        device=device,
        acting_device=device if config.collector.kind == "single" else CPU,
    )
    try:
        if config.resume is not None:
            learner.resume(folder)
        else:
            learner.begin(folder)
            write_config(learner.run.config, config)
    except BaseException:
        learner.collector.shutdown()
        raise
    return learner, scenario


def start_network(config: TrainingConfig, scenario: Scenario) -> NAFNetwork:
    """The network as the training finds it: untrained, or that of the initial checkpoint."""
    form = config.network
    network = make_network(
        scenario, form.mu, form.hidden_sizes, knows_action_cost=form.knows_action_cost
    )
    path = config.initial_checkpoint
    # A run that is resumed has weights of its own.
    if path is None or config.resume is not None:
        return network
    initial = load_checkpoint(Path(path), scenario).network
    for name, wanted, found in (
        ("mu", network.mu_name, initial.mu_name),
        ("hidden_sizes", network.hidden_sizes, initial.hidden_sizes),
        ("knows_action_cost", network.has_action_costs, initial.has_action_costs),
    ):
        if found != wanted:
            raise ConfigError(
                f"network.{name} = {wanted!r}: must be {found!r}, that of initial_checkpoint = "
                f"{path!r}"
            )
    return initial


def report(learner: Learner, config: TrainingConfig, scenario: Scenario) -> dict[str, Any]:
    """Evaluate the final policy, write evaluation.json and the figures."""
    run = learner.run
    number = config.evaluation.final_num_maneuvers
    network = load_checkpoint(run.checkpoints / FINAL_MODEL, scenario).network
    with tqdm(total=2 * number, unit="maneuver", desc="evaluating") as bar:
        maneuvers = run_maneuvers(
            scenario,
            greedy_policy(network),
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


def choose_recipe(arguments: Sequence[str]) -> list[str]:
    """``recipe=interactive`` for a scenario with two actions, unless a recipe is named.

    Args:
        arguments: of the command line. What is wrong with them is left to ``main``.
    """
    named = dict(one.split("=", 1) for one in arguments if "=" in one)
    if "recipe" in named or "scenario" not in named:
        return []
    try:
        scenario = load_scenario(named["scenario"].strip("'\""))
    except (ValueError, OSError):
        return []
    return [] if scenario.action.longitudinal is None else ["recipe=interactive"]


if __name__ == "__main__":
    sys.argv += choose_recipe(sys.argv[1:])
    main()
