"""The newest saved model of a training run, while the run goes on or long after."""

from collections.abc import Callable
from itertools import takewhile
from pathlib import Path
from typing import NamedTuple, Protocol

from marl_lanes.evaluation.driving import Policy
from marl_lanes.naf.checkpoint import CheckpointError, greedy_policy
from marl_lanes.scenario import Scenario, load_scenario
from marl_lanes.training.checkpoint import load_policy
from marl_lanes.training.inputs import find_scenario
from marl_lanes.training.run_folder import CHECKPOINTS_FOLDER, FINAL_MODEL


class Model(NamedTuple):
    """Who drives the lane changers."""

    label: str
    policy: Policy


class _File(NamedTuple):
    """One version of a checkpoint's file."""

    path: Path
    modified: int
    """[ns]"""
    size: int


class Models(Protocol):
    """Who drives the next episode."""

    waiting: str
    """What viewers read while there is no model."""
    trouble: str | None
    """Why what is newest does not drive, in one line."""

    def find_newest(self) -> Model | None:
        """The model to drive now; None while there is none."""


class FixedModel:
    """Always the same model."""

    def __init__(self, model: Model) -> None:
        self.waiting = ""
        self.trouble: str | None = None
        self.model = model

    def find_newest(self) -> Model:
        """The model."""
        return self.model


class RunModels:
    """The models that a run saves.

    The newest is that with the most transitions, or the final one, unless a model was saved after
    that. A file that cannot be read is passed over, and read again only when it has changed.

    Args:
        folder: of the run.
        scenario: by default that of the run.
        warn: told in one line about every trouble.

    Raises:
        ConfigError: the folder is not one of a run.
        ScenarioError: its scenario cannot be loaded.
    """

    def __init__(
        self, folder: Path, scenario: Scenario | None, *, warn: Callable[[str], object]
    ) -> None:
        path = find_scenario(folder)
        self.scenario = load_scenario(path) if scenario is None else scenario
        self.folder = folder
        self.waiting = f"{folder} has no saved model yet; the first one will drive"
        self.trouble: str | None = None
        self._warn = warn
        self._broken: dict[_File, str] = {}
        self._known: set[_File] = set()
        self._driving: tuple[_File, Model] | None = None

    def find_newest(self) -> Model | None:
        """The newest model that can be read; the last one if there is no other; or None."""
        files = self._list()
        fresh = [file for file in self._newer_of(files) if file not in self._known]
        self._known |= set(files)
        for file in fresh:
            if self._load(file):
                break
        troubles = [self._broken[file] for file in self._newer_of(files) if file in self._broken]
        if not self.folder.is_dir():
            troubles.insert(0, f"{self.folder}: the run folder is gone")
            if self.trouble != troubles[0]:
                self._warn(troubles[0])
        self.trouble = troubles[0] if troubles else None
        return None if self._driving is None else self._driving[1]

    def _newer_of(self, files: list[_File]) -> list[_File]:
        """Those that are newer than the one that drives; all if that has gone."""
        driving = None if self._driving is None else self._driving[0]
        return list(takewhile(lambda file: file != driving, files))

    def _load(self, file: _File) -> bool:
        """Let a model drive; whether it can be read."""
        try:
            checkpoint = load_policy(file.path, self.scenario)
        except CheckpointError as error:
            self._broken[file] = f"passed over: {error}"
            self._warn(self._broken[file])
            return False
        run = self.folder.resolve().name
        label = f"{run}/{file.path.name}, {checkpoint.transitions:,} transitions"
        self._driving = file, Model(label, greedy_policy(checkpoint.network))
        return True

    def _list(self) -> list[_File]:
        """The files that are there, the newest first."""
        folder = self.folder / CHECKPOINTS_FOLDER
        found = []
        for path in [*sorted(folder.glob("step_*.pt"), reverse=True), folder / FINAL_MODEL]:
            try:
                status = path.stat()
            except OSError:
                continue
            found.append(_File(path, status.st_mtime_ns, status.st_size))
        if found and found[-1].path.name == FINAL_MODEL and found[-1].modified >= found[0].modified:
            found.insert(0, found.pop())
        return found
