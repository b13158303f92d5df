"""Replays of the roads on which maneuvers of the final evaluation failed."""

from collections.abc import Sequence

from tqdm import tqdm

from marl_lanes.browser.bundle import write_replay
from marl_lanes.browser.optima import find_optima
from marl_lanes.evaluation.driving import Policy
from marl_lanes.evaluation.maneuver_table import Row
from marl_lanes.evaluation.recording import record_maneuvers
from marl_lanes.report.failures import replay_of
from marl_lanes.scenario import Scenario
from marl_lanes.training.run_folder import FINAL_MODEL, RunFolder
from marl_lanes.trajectory.file import read_trajectory

MAX_REPLAYS = 20
"""Roads with a replay; a replay has up to some MB."""

RECORDING = "final_evaluation"
"""Name of the recorded roads among the run's trajectories."""


def replay_failures(
    run: RunFolder, scenario: Scenario, policy: Policy, table: Sequence[Row], *, seed: int
) -> None:
    """Drive the final evaluation again, record the roads with failures, and write their replays.

    At most MAX_REPLAYS roads, those with the lowest numbers. If nothing failed, it is road 0.

    Args:
        run: the run folder; trajectories and replays go there.
        scenario: of the evaluation.
        policy: that was evaluated.
        table: all its maneuvers, ordered by road and command.
        seed: of the evaluation.

    Raises:
        RuntimeError: the maneuvers do not end as they did before.
    """
    roads = sorted({row.road for row in table if not row.is_success})[:MAX_REPLAYS] or [0]
    path = run.trajectory(RECORDING)
    with tqdm(total=len(table), unit="maneuver", desc="recording") as bar:
        again = record_maneuvers(
            path,
            f"checkpoints/{FINAL_MODEL}",
            scenario,
            policy,
            len(table),
            seed=seed,
            roads=roads,
            progress=lambda count: bar.update(min(count, len(table)) - bar.n),
        )
    ends = [(one.env, one.command, one.outcome.name.lower()) for one in again]
    if ends != [(row.road, row.command, row.outcome) for row in table]:
        raise RuntimeError(
            "the final evaluation ended otherwise when it was driven again: the policy is not "
            "a function of what it observes"
        )
    trajectory = read_trajectory(path)
    for road in tqdm(roads, unit="replay", desc="replays"):
        optima = find_optima(trajectory.rows_of(road), scenario)
        write_replay(run.path / replay_of(road), trajectory, road, optima)
