"""The paper's Figure 8, as a figure and as a film: the first, the final and the last model."""

import sys
from typing import NamedTuple

from tqdm import tqdm

from marl_lanes.evaluation.figures import draw_maneuver
from marl_lanes.evaluation.recording import record_road
from marl_lanes.evaluation.rollout import run_maneuvers
from marl_lanes.naf.checkpoint import Checkpoint, PolicyNetwork, greedy_policy
from marl_lanes.rendering.excerpt import find_excerpt
from marl_lanes.rendering.film import choose_size, cut, write_film
from marl_lanes.rendering.options import ViewOptions
from marl_lanes.scenario import Scenario
from marl_lanes.training.checkpoint import load_policy
from marl_lanes.training.run_folder import FINAL_MODEL, RunFolder

_MAX_FILM = 30.0
"""[s] Of the road's time; the film of a training is short."""


class _Shown(NamedTuple):
    """A model of a run, and what it is there: first, final, last, or several of these."""

    model: Checkpoint[PolicyNetwork]
    roles: tuple[str, ...]

    @property
    def label(self) -> str:
        return f"{' and '.join(self.roles)}: {self.model.transitions:,} transitions"


def draw_first_and_last(run: RunFolder, scenario: Scenario, seed: int) -> None:
    """Draw yaw acceleration and yaw rate of the first, the final and the last model.

    They drive the same maneuver. A training whose final model is the best that it saved may have
    chosen the first or one in between; beside it the last one shows what became of the training.

    Args:
        run: the folder with the models; the figure goes to its ``figures``.
        scenario: to drive on.
        seed: of the traffic.
    """
    shown = _load_shown(run, scenario)
    driven = {
        one.label: run_maneuvers(scenario, greedy_policy(one.model.network), 1, seed=seed)
        for one in shown
    }
    draw_maneuver(run.figures / "first_and_last", _title(shown), driven, scenario)


def film_first_and_last(run: RunFolder, scenario: Scenario, seed: int) -> None:
    """Film the first lane change of the final model, and beside it what the others do.

    Without such a lane change there is no film, which is told on stderr.

    Args:
        run: the folder with the models and of the film.
        scenario: to drive on.
        seed: of the traffic.
    """
    shown = _load_shown(run, scenario)
    roads = [
        record_road(scenario, greedy_policy(one.model.network), seed=seed, name=one.label)
        for one in shown
    ]
    # The excerpt is of the first of the roads.
    order = sorted(range(len(shown)), key=lambda index: "final" not in shown[index].roles)
    excerpt = find_excerpt([roads[index].rows for index in order])
    if excerpt is None:
        tqdm.write("no film: the final model never engages on the first road", file=sys.stderr)
        return
    end = min(excerpt.end, excerpt.start + _MAX_FILM)
    vehicles = dict(zip(order, excerpt.vehicles, strict=True))
    clips = [
        cut(one.label, road.frames(0), excerpt.start, end, vehicles[index])
        for index, (one, road) in enumerate(zip(shown, roads, strict=True))
    ]
    view = ViewOptions(size=choose_size(run.film, len(clips)))
    with tqdm(unit="frame", desc="filming") as bar:

        def show(count: int, number: int) -> None:
            bar.total = number
            bar.update(count - bar.n)

        write_film(run.film, clips, view, progress=show)


def _title(shown: list[_Shown]) -> str:
    if len(shown) == 1:
        return "A maneuver with the only saved model"
    if "final" in shown[0].roles:
        return "One maneuver: the first saved model, chosen, and the last"
    if "final" in shown[-1].roles:
        return "The same maneuver with the first saved and the final model"
    return "The same maneuver: first saved, final and last model"


def _load_shown(run: RunFolder, scenario: Scenario) -> list[_Shown]:
    """The models in the order of their transitions, each once."""
    saved = sorted(run.checkpoints.glob("step_*.pt"))
    final = run.checkpoints / FINAL_MODEL
    paths = {"first": (saved or [final])[0], "final": final, "last": (saved or [final])[-1]}
    models = {role: load_policy(path, scenario) for role, path in paths.items()}
    # A final model that is not one of the saved ones comes after them all.
    if models["final"].transitions > models["last"].transitions:
        models["last"] = models["final"]
    counts = sorted({model.transitions for model in models.values()})
    roles = {
        count: tuple(role for role, model in models.items() if model.transitions == count)
        for count in counts
    }
    return [_Shown(models[roles[count][0]], roles[count]) for count in counts]
