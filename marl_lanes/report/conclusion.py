"""What a finished training leaves: evaluation, figures, film, replays, report."""

from importlib.metadata import version
from platform import python_version
from typing import Any

from tqdm import tqdm

from marl_lanes.evaluation.figures import draw_training
from marl_lanes.evaluation.headlines import estimate_headlines
from marl_lanes.evaluation.intervals import CONFIDENCE
from marl_lanes.evaluation.maneuver_table import tabulate, write_maneuvers
from marl_lanes.evaluation.metrics import measure_each, summarise
from marl_lanes.evaluation.rollout import run_maneuvers
from marl_lanes.files import write_json
from marl_lanes.naf.checkpoint import greedy_policy
from marl_lanes.report.first_and_last import draw_first_and_last, film_first_and_last
from marl_lanes.report.page import write_report
from marl_lanes.report.replays import replay_failures
from marl_lanes.scenario import Scenario
from marl_lanes.training.checkpoint import load_policy
from marl_lanes.training.config import EvaluationConfig
from marl_lanes.training.run_folder import (
    EVALUATION_FILE,
    FINAL_MANEUVERS_FILE,
    FINAL_MODEL,
    RunFolder,
)

PACKAGES = ("marl-lanes", "torch", "torchrl", "tensordict", "numba", "numpy")
"""The packages whose versions the evaluation names."""


def conclude(
    run: RunFolder, settings: EvaluationConfig, scenario: Scenario, pretraining_transitions: int
) -> dict[str, Any]:
    """Evaluate the final policy; write its numbers, the figures, the film and the report.

    Args:
        run: the folder of a training that is over.
        settings: of the evaluation.
        scenario: to evaluate on.
        pretraining_transitions: end of stage one, 0 if there is one stage.

    Returns:
        the metrics.
    """
    number = settings.final_num_maneuvers
    policy = greedy_policy(load_policy(run.checkpoints / FINAL_MODEL, scenario).network)
    with tqdm(total=2 * number, unit="maneuver", desc="evaluating") as bar:
        maneuvers = run_maneuvers(
            scenario,
            policy,
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
    table = tabulate(maneuvers, measured, scenario)
    write_maneuvers(run.path / FINAL_MANEUVERS_FILE, table)
    draw_training(run.path, pretraining_transitions, summary["mean_optimal_return"])
    draw_first_and_last(run, scenario, settings.seed)
    if settings.record:
        film_first_and_last(run, scenario, settings.seed)
        replay_failures(run, scenario, policy, table, seed=settings.seed)
    write_report(run.path)
    return summary
