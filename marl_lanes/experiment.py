"""A training of the lane changers from its configuration to its report, for any algorithm."""

import sys
from collections.abc import Callable, Mapping
from functools import partial
from math import ceil
from pathlib import Path
from typing import Any

import torch

from marl_lanes.envs.batched import LaneChangeEnv
from marl_lanes.evaluation.driving import check_first_command
from marl_lanes.evaluation.metrics import evaluate
from marl_lanes.evaluation.recording import record_maneuvers
from marl_lanes.evaluation.rollout import check_episodes
from marl_lanes.evaluation.tables import format_summary
from marl_lanes.extras import need
from marl_lanes.files import write_text
from marl_lanes.naf.checkpoint import PolicyNetwork, greedy_policy
from marl_lanes.report.conclusion import conclude
from marl_lanes.scenario import Scenario, load_scenario
from marl_lanes.scenario.dispositions import LEARNED
from marl_lanes.training.algorithms.algorithm import Algorithm
from marl_lanes.training.collected import load_collected
from marl_lanes.training.collectors import MakeCollector
from marl_lanes.training.config import ChangersConfig, ConfigError
from marl_lanes.training.device_collector import DeviceCollector
from marl_lanes.training.failures import ending
from marl_lanes.training.inputs import LEARNED_FILE, check_inputs, keep_inputs, read_scenario
from marl_lanes.training.learner import Learner
from marl_lanes.training.run_folder import COMMAND_FILE, check_empty
from marl_lanes.training.sizes import check_sizes
from marl_lanes.training.timing import format_split
from marl_lanes.training.torch_settings import take_resources
from marl_lanes.training.transitions import CPU
from marl_lanes.training.workers import choose_collector

MakeAlgorithm = Callable[[LaneChangeEnv, Scenario, torch.device, torch.device], Algorithm]
"""Makes an algorithm from the environment that collects, the scenario, and the devices where it
learns and acts. Torch's generator is seeded before."""


def start(
    config: ChangersConfig,
    make_algorithm: MakeAlgorithm,
    command: str,
    *,
    has_state: bool = False,
) -> tuple[Learner, Scenario]:
    """Begin a new run, or resume one from its folder alone. After an error no file is left behind.

    Args:
        config: of the run.
        make_algorithm: what the learner is made of.
        command: the command line that begins the run; a resumed run keeps its own.
        has_state: whether the algorithm needs the road's state.

    Raises:
        ConfigError, ScenarioError, CheckpointError, MissingExtraError: the run cannot be made.
    """
    folder = Path(config.output)
    is_new = config.resume is None
    scenario = load_scenario(config.scenario) if is_new else read_scenario(folder)
    num_commands = check_episodes(scenario)
    collected = load_collected(scenario, config.training_overrides)
    check_sizes(config, collected, scenario, has_state=has_state)
    files = _find_files(scenario, collected)
    if is_new:
        check_empty(folder)
    else:
        check_inputs(folder, files)
    if config.evaluation.record:
        for package in ("pygame", "imageio_ffmpeg"):
            need(package, "view")
    device = take_resources(config)
    # Workers have the roads on the CPU.
    acting_device = device if config.collector.kind == "single" else CPU
    env = LaneChangeEnv(
        collected,
        config.collector.num_envs // config.num_workers,
        device=acting_device,
        seed=config.seed,
        has_state=has_state,
    )
    torch.manual_seed(config.seed)
    algorithm = make_algorithm(env, scenario, device, acting_device)
    evaluation = config.evaluation
    num_roads = ceil(evaluation.num_maneuvers / num_commands)
    check_first_command(scenario, num_roads, evaluation.saved_models_seed)
    learner = Learner(
        config,
        env,
        algorithm,
        make_collector=_choose_collector(config, env, algorithm),
    )

    def keep() -> None:
        write_text(folder / COMMAND_FILE, f"{command}\n")
        keep_inputs(folder, config, scenario, files)

    try:
        if is_new:
            learner.begin(folder, keep)
        else:
            learner.resume(folder)
    except BaseException:
        learner.collector.shutdown()
        raise
    return learner, read_scenario(folder)


def _choose_collector(
    config: ChangersConfig, env: LaneChangeEnv, algorithm: Algorithm
) -> MakeCollector:
    """What makes the collector that is configured; on a GPU one that does not wait for it."""
    goes_on = env.scenario.num_agents is None and env.scenario.horizon is None
    if config.collector.kind == "single" and env.device != CPU and goes_on:
        is_graphed = algorithm.is_graphed and env.simulator.is_on_gpu
        return partial(DeviceCollector, is_graphed=is_graphed)
    return choose_collector(config.collector, config.num_workers, config.ray.address)


def _find_files(scenario: Scenario, training_scenario: Scenario) -> dict[str, Path]:
    """The files that a run reads besides its scenario, by the names of their copies."""
    checkpoint = scenario.followers.learned.checkpoint
    if training_scenario.followers.learned.checkpoint != checkpoint:
        raise ConfigError(
            "training_overrides: followers.learned.checkpoint: must be set in the scenario"
        )
    mixes = (scenario.followers.external_names, training_scenario.followers.external_names)
    is_read = checkpoint is not None and any(LEARNED in names for names in mixes)
    return {LEARNED_FILE: Path(str(checkpoint))} if is_read else {}


def run(learner: Learner, config: ChangersConfig, scenario: Scenario) -> None:
    """Train until the end or an interruption, and report. A failure ends the program."""
    with ending(learner.run.path):
        try:
            _train(learner, config, scenario)
        finally:
            learner.close()


def _train(learner: Learner, config: ChangersConfig, scenario: Scenario) -> None:
    for index, place in enumerate(learner.collector.places):
        print(f"worker {index}: {place}", file=sys.stderr)

    def evaluate_model(network: PolicyNetwork, recorded: Path | None) -> Mapping[str, Any]:
        settings = config.evaluation
        maneuvers = record_maneuvers(
            recorded,
            "" if recorded is None else f"checkpoints/{recorded.stem}.pt",
            scenario,
            greedy_policy(network),
            settings.num_maneuvers,
            seed=settings.saved_models_seed,
            roads=[0],
        )
        return evaluate(maneuvers, scenario)

    if not learner.train(evaluate_model):
        print(f"interrupted; continue with resume={learner.run.path}")
        return
    stage_one = learner.algorithm.pretraining_transitions
    summary = conclude(learner.run, config.evaluation, scenario, stage_one)
    print(f"run folder: {learner.run.path}")
    print(format_summary({**learner.seconds, **learner.memory, **summary}))
    print(f"time of the training, without evaluating and saving:\n{format_split(learner.split)}")
