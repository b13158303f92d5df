"""The report as a page: what the template shows, and its file."""

import base64
from importlib.resources import files
from pathlib import Path
from typing import Any, NamedTuple

from marl_lanes.colours import DARK, LIGHT
from marl_lanes.evaluation.headlines import COST_RATIO, HEADLINES
from marl_lanes.evaluation.style import FORMATS
from marl_lanes.evaluation.tables import choose_decimals
from marl_lanes.extras import need
from marl_lanes.files import write_text
from marl_lanes.report.failures import (
    count_kinds,
    describe_replays,
    find_warnings,
    list_failures,
    replay_of,
)
from marl_lanes.report.run_files import Evaluation, RunFiles, read_run
from marl_lanes.report.svg import inline_svg
from marl_lanes.training.run_folder import FILM_FILE

REPORT_FILE = "report.html"
"""File name in the run folder."""

MAX_FILM_BYTES = 4_000_000
"""A larger film is linked, not contained."""

FIGURES = {
    "loss": "Figure 6a of the paper: the loss over the training, on a logarithmic scale.",
    "returns": "Figure 6b of the paper: the total reward of each maneuver while training, with the "
    "noise of exploration; the optimum is without it.",
    "saved_models": "Figure 7 of the paper: the mean return of each saved model over its completed "
    "maneuvers, without noise; below it the shares that succeeded and that were completed.",
    "first_and_last": "Figure 8 of the paper: yaw acceleration and yaw rate in one maneuver, with "
    "the first saved, the final and the last saved model.",
}
"""Caption of each figure, in the order of the page."""


class Number(NamedTuple):
    """A headline as it is shown."""

    key: str
    title: str
    value: str
    interval: str
    meaning: str


def write_report(run: Path) -> Path:
    """Write ``report.html`` into the folder of a finished run.

    Args:
        run: the run folder.

    Returns:
        the path of the report.

    Raises:
        ReportError: the folder holds no finished run, or a file is not as training writes it.
        MissingExtraError: Jinja is not installed.
    """
    jinja = need("jinja2", "view")
    source = files("marl_lanes.report").joinpath("report.html.jinja").read_text(encoding="utf-8")
    environment = jinja.Environment(
        autoescape=True, undefined=jinja.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    page = environment.from_string(source).render(_collect(read_run(run), jinja.utils.markupsafe))
    target = run / REPORT_FILE
    write_text(target, page + "\n")
    return target


def _collect(run: RunFiles, markupsafe: Any) -> dict[str, Any]:
    """What the template shows."""
    failures = list_failures(run)
    without = next((one.maneuver.road for one in failures if one.replay is None), None)
    return {
        "run": run,
        "num_successes": sum(one.is_success for one in run.maneuvers),
        "num_roads": len({one.road for one in run.maneuvers}),
        "confidence": f"{100.0 * run.evaluation.confidence:g}\N{NO-BREAK SPACE}%",
        "warnings": find_warnings(run),
        "numbers": make_numbers(run.evaluation),
        "film": _embed_film(run),
        "figures": [
            {
                "name": name,
                "caption": caption,
                # inline_svg lets only harmless elements through.
                "svg": markupsafe.Markup(
                    inline_svg(run.path / "figures" / f"{name}.svg", name, caption)
                ),
                "files": [f"figures/{name}.{kind}" for kind in FORMATS],
            }
            for name, caption in FIGURES.items()
        ],
        "failures": failures,
        "kinds": count_kinds(failures),
        "replays": [(road, replay_of(road)) for road in sorted(run.replays)],
        "commands": describe_replays(run, 0 if without is None else without),
        "seconds": {
            name.removeprefix("seconds_"): f"{value:,.2f}" for name, value in run.seconds.items()
        },
        "light": LIGHT.variables(),
        "dark": DARK.variables(),
    }


def make_numbers(evaluation: Evaluation) -> list[Number]:
    """The headline numbers that the run has, as text."""
    numbers = []
    for headline in HEADLINES:
        found = evaluation.intervals.get(headline.key)
        if found is None:
            continue
        unit = "" if headline.unit == "1" else f"\N{NO-BREAK SPACE}{headline.unit}"
        meaning, interval = headline.meaning, ""
        decimals = choose_decimals(headline.decimals, headline.factor, evaluation.num_maneuvers)

        def show(value: float, factor: float = headline.factor, decimals: int = decimals) -> str:
            return f"{factor * value:.{decimals}f}"

        if found.value is None:
            value = "not defined"
            if headline.key == COST_RATIO and evaluation.no_cost_ratio is not None:
                meaning = f"{meaning} Here there is none: {evaluation.no_cost_ratio}."
        else:
            value = show(found.value) + unit
        if found.low is not None and found.high is not None:
            interval = f"{show(found.low)} to {show(found.high)}{unit}"
        numbers.append(Number(headline.key, headline.title, value, interval, meaning))
    return numbers


def _embed_film(run: RunFiles) -> str | None:
    """The film as a data URL; None if there is none or it is too large."""
    path = run.path / FILM_FILE
    if not run.has_film or path.stat().st_size > MAX_FILM_BYTES:
        return None
    return f"data:video/mp4;base64,{base64.b64encode(path.read_bytes()).decode('ascii')}"
