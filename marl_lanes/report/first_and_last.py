"""The paper's Figure 8, as a figure and as a film: the first and the last saved model."""

import sys

from tqdm import tqdm

from marl_lanes.evaluation.figures import draw_maneuver
from marl_lanes.evaluation.recording import record_road
from marl_lanes.evaluation.rollout import run_maneuvers
from marl_lanes.naf.checkpoint import Checkpoint, PolicyNetwork, greedy_policy
from marl_lanes.rendering.excerpt import find_excerpt
from marl_lanes.rendering.film import cut, write_film
from marl_lanes.scenario import Scenario
from marl_lanes.training.checkpoint import load_policy
from marl_lanes.training.run_folder import FINAL_MODEL, RunFolder

_MAX_FILM = 30.0
"""[s] Of the road's time; the film of a training is short."""


def draw_first_and_last(run: RunFolder, scenario: Scenario, seed: int) -> None:
    """Draw yaw acceleration and yaw rate of the two models in the same maneuver.

    Args:
        run: the folder with the models; the figure goes to its ``figures``.
        scenario: to drive on.
        seed: of the traffic.
    """
    loaded = _load_first_and_last(run, scenario)
    first, last = (
        run_maneuvers(scenario, greedy_policy(model.network), 1, seed=seed)[0] for model in loaded
    )
    labels = (_label(loaded[0]), _label(loaded[1]))
    draw_maneuver(run.figures / "first_and_last", [first], [last], labels, scenario)


def film_first_and_last(run: RunFolder, scenario: Scenario, seed: int) -> None:
    """Film the first lane change of the last model, and beside it what the first model does.

    Without such a lane change there is no film, which is told on stderr.

    Args:
        run: the folder with the models and of the film.
        scenario: to drive on.
        seed: of the traffic.
    """
    loaded = _load_first_and_last(run, scenario)
    roads = [
        record_road(scenario, greedy_policy(model.network), seed=seed, name=str(model.transitions))
        for model in loaded
    ]
    excerpt = find_excerpt([road.rows for road in reversed(roads)])
    if excerpt is None:
        tqdm.write("no film: the last model never engages on the first road", file=sys.stderr)
        return
    end = min(excerpt.end, excerpt.start + _MAX_FILM)
    clips = [
        cut(_label(model), road.frames(0), excerpt.start, end, vehicle)
        for model, road, vehicle in zip(loaded, roads, reversed(excerpt.vehicles), strict=True)
    ]
    with tqdm(unit="frame", desc="filming") as bar:

        def show(count: int, number: int) -> None:
            bar.total = number
            bar.update(count - bar.n)

        write_film(run.film, clips, progress=show)


def _label(model: Checkpoint[PolicyNetwork]) -> str:
    return f"{model.transitions:,} transitions"


def _load_first_and_last(run: RunFolder, scenario: Scenario) -> list[Checkpoint[PolicyNetwork]]:
    saved = sorted(run.checkpoints.glob("step_*.pt"))
    paths = (saved[0] if saved else run.checkpoints / FINAL_MODEL, run.checkpoints / FINAL_MODEL)
    return [load_policy(path, scenario) for path in paths]
