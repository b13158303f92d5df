"""The files of a run folder that its report shows, read and checked."""

import csv
import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, TypeVar

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field

from marl_lanes.evaluation.headlines import HEADLINES
from marl_lanes.files import open_regular
from marl_lanes.scenario.messages import shown, shown_name
from marl_lanes.training.config import CONFIG_FILE, ConfigError, validate
from marl_lanes.training.inputs import find_scenario
from marl_lanes.training.run_folder import (
    CHOICE_FILE,
    COMMAND_FILE,
    EVALUATION_FILE,
    FILM_FILE,
    FINAL_MANEUVERS_FILE,
    TIMES_FILE,
)

REPLAYS_FOLDER = "replays"
"""Folder of the replays; ``road_0017.html`` is that of road 17."""

Model = TypeVar("Model", bound=BaseModel)

_REPLAY = re.compile(r"road_(\d+)\.html")


class ReportError(ValueError):
    """A folder of which no report can be written; the message says why."""


class _Stored(BaseModel):
    """Part of a file; other parts are not read."""

    model_config = ConfigDict(frozen=True, allow_inf_nan=False)


class Interval(_Stored):
    """A headline's value and the ends of its interval; None if not defined."""

    value: float | None
    low: float | None
    high: float | None


class Evaluation(_Stored):
    """The final evaluation."""

    scenario: str
    policy: str
    seed: int
    num_maneuvers: int = Field(ge=1)
    no_cost_ratio: str | None
    confidence: float = Field(gt=0.0, lt=1.0)
    intervals: dict[str, Interval]
    versions: dict[str, str]


def _empty_is_none(cell: Any) -> Any:
    return None if cell == "" else cell


_Seconds = Annotated[float | None, BeforeValidator(_empty_is_none)]


class FinalManeuver(_Stored):
    """A maneuver of the final evaluation."""

    road: int = Field(ge=0)
    command: int = Field(ge=0)
    vehicle: int
    outcome: str
    is_success: bool
    failure: str
    command_time: _Seconds
    end_time: _Seconds
    failure_time: _Seconds
    num_aborts: int


class Choice(_Stored):
    """Which saved model is the final one."""

    chosen: str


@dataclass(frozen=True)
class RunFiles:
    """What a report is made of.

    Args:
        path: the run folder.
        evaluation: the final evaluation.
        maneuvers: its maneuvers.
        seconds: of the training, by activity.
        config_text: the configuration as it is stored.
        scenario: the scenario's file.
        command: the command line that began the run.
        chosen: the saved model that became the final one by a criterion, None without one.
        replays: the roads that have a replay.
        has_film: whether there is a film.
    """

    path: Path
    evaluation: Evaluation
    maneuvers: tuple[FinalManeuver, ...]
    seconds: Mapping[str, float]
    config_text: str
    scenario: str
    command: str
    chosen: str | None
    replays: frozenset[int]
    has_film: bool


def read_run(path: Path) -> RunFiles:
    """Read a finished run.

    Args:
        path: the run folder.

    Raises:
        ReportError: the folder holds no finished run, or a file is not as training writes it.
    """
    try:
        scenario = find_scenario(path)
    except ConfigError as error:
        raise ReportError(str(error)) from None
    evaluation = _validate(Evaluation, _read_json(path / EVALUATION_FILE), path / EVALUATION_FILE)
    # A run of another version may lack a number that this one knows, but not the main one.
    main = HEADLINES[0].key
    if main not in evaluation.intervals:
        raise ReportError(f"{path / EVALUATION_FILE}: intervals.{main}: must be given")
    choice = path / CHOICE_FILE
    found = (_REPLAY.fullmatch(file.name) for file in (path / REPLAYS_FOLDER).glob("*.html"))
    return RunFiles(
        path=path,
        evaluation=evaluation,
        maneuvers=_read_maneuvers(path / FINAL_MANEUVERS_FILE, evaluation.num_maneuvers),
        seconds=_read_seconds(path / TIMES_FILE),
        config_text=_read_text(path / CONFIG_FILE),
        scenario=str(scenario),
        command=_read_text(path / COMMAND_FILE).strip(),
        chosen=_validate(Choice, _read_json(choice), choice).chosen if choice.is_file() else None,
        replays=frozenset(int(match[1]) for match in found if match),
        has_film=(path / FILM_FILE).is_file(),
    )


def _read_text(path: Path) -> str:
    try:
        with open_regular(path) as file:
            return file.read().decode("utf-8")
    except FileNotFoundError:
        raise ReportError(
            f"run {path.parent}: has no {path.name}: it is not finished, or of an older version; "
            f"resume={path.parent} finishes it"
        ) from None
    except (OSError, UnicodeDecodeError) as error:
        raise ReportError(f"{path}: cannot be read: {error}") from None


def _read_json(path: Path) -> Any:
    try:
        return json.loads(_read_text(path))
    except (ValueError, RecursionError) as error:
        raise ReportError(f"{path}: not readable as JSON: {error}") from None


def _validate(kind: type[Model], fields: Any, path: Path) -> Model:
    if not isinstance(fields, dict):
        raise ReportError(f"{path}: must be a mapping of fields")
    try:
        return validate(kind, fields, f"{path}: ")
    except ConfigError as error:
        raise ReportError(str(error)) from None


def _read_maneuvers(path: Path, wanted: int) -> tuple[FinalManeuver, ...]:
    try:
        rows = list(csv.DictReader(_read_text(path).splitlines()))
    except csv.Error as error:
        raise ReportError(f"{path}: not readable as CSV: {error}") from None
    if len(rows) != wanted:
        raise ReportError(
            f"{path}: has {len(rows)} maneuvers: must have the {wanted} of {EVALUATION_FILE}"
        )
    return tuple(_validate(FinalManeuver, row, path) for row in rows)


def _read_seconds(path: Path) -> dict[str, float]:
    seconds = _read_json(path)
    if not isinstance(seconds, dict):
        raise ReportError(f"{path}: must be a mapping of fields")
    for name, value in seconds.items():
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise ReportError(f"{path}: {shown_name(name)} = {shown(value)}: must be a number")
    return seconds
