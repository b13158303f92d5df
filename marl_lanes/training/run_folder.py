"""The folder of a training run: config, tables, checkpoints, trajectories, figures."""

import csv
import hashlib
import os
import shutil
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from math import inf
from pathlib import Path
from typing import Any, BinaryIO

import yaml
from torch.utils.tensorboard import SummaryWriter

from marl_lanes.files import (
    LOCK_FILE,
    LockedError,
    copy_file,
    lock_folder,
    open_regular,
    write_json,
)
from marl_lanes.naf.checkpoint import CheckpointError
from marl_lanes.training.config import CONFIG_FILE, EVALUATED, ConfigError

Value = float | int | str

FINAL_MODEL = "final.pt"
"""File name of the model at the end of the training."""

STATE_FILE = "resume.pt"
"""File name of the training state."""

BUFFER_FOLDER = "replay"
"""Folder of the replay buffer's files while a training runs."""

CHECKPOINTS_FOLDER = "checkpoints"
"""Folder of the saved models."""

TRAJECTORIES_FOLDER = "trajectories"
"""Folder of recorded roads."""

FILM_FILE = "film.mp4"
"""File name of the film, if there is one."""

TIMES_FILE = "training.json"
"""File name of the seconds that the training took; it is there when the training is over."""

EVALUATIONS_FILE = "evaluations.csv"
"""File name of the saved models' metrics."""

EVALUATION_FILE = "evaluation.json"
"""File name of the final evaluation."""

FINAL_MANEUVERS_FILE = "final_maneuvers.csv"
"""File name of the maneuvers of the final evaluation."""

COMMAND_FILE = "command.txt"
"""File name of the command line that began the run."""

CHOICE_FILE = "choice.json"
"""File name of what the saved models are worth by the criterion, and of the best."""


Extent = Mapping[str, Any]
"""Where a table ended: ``size`` in bytes, and the ``sha256`` of so many."""


class Table:
    """A CSV file that grows row by row; its first column is the number of transitions.

    Args:
        path: of the file.
        columns: their names.
        extent: None to begin the table anew; otherwise where to go on. What is beyond is cut off.

    Raises:
        OSError: it cannot be written.
    """

    def __init__(self, path: Path, columns: Sequence[str], *, extent: Extent | None = None) -> None:
        self.path = path
        if extent is not None:
            os.truncate(path, extent["size"])
        mode = "w" if extent is None else "a"
        self._file = path.open(mode, newline="", encoding="utf-8")
        self._writer = csv.writer(self._file)
        if extent is None:
            self.append(columns)

    def append(self, *rows: Sequence[Value]) -> None:
        """Add rows, values in the order of the columns."""
        self._writer.writerows(rows)
        self._file.flush()

    def take_extent(self) -> Extent:
        """Where it ends now; so much is on the disk."""
        os.fsync(self._file.fileno())
        content = self.path.read_bytes()
        return {"size": len(content), "sha256": hashlib.sha256(content).hexdigest()}

    def close(self) -> None:
        """Close the file."""
        self._file.close()


def check_extent(path: Path, extent: Any) -> None:
    """Refuse a table whose rows up to its extent are not those that were written.

    Raises:
        CheckpointError: they have changed, or are gone.
    """
    try:
        size, wanted = int(extent["size"]), extent["sha256"]
        with open_regular(path) as file:
            content = file.read(size)
    except (LookupError, TypeError, ValueError, OSError):
        content, wanted = b"", None
    if hashlib.sha256(content).hexdigest() != wanted:
        raise CheckpointError(
            f"table {path}: must begin with the rows of the run that {STATE_FILE} is of; it has "
            "changed since, or is gone"
        )


def count_transitions(path: Path) -> tuple[int, int]:
    """Transitions of a whole run, and of the demonstrations that it began with.

    A saved model that was chosen as the final one knows only those up to it.

    Args:
        path: the folder of a finished run.

    Raises:
        ConfigError: a file is damaged.
        OSError: it cannot be read.
    """
    table, config = path / EVALUATIONS_FILE, path / CONFIG_FILE
    try:
        *_, last = csv.DictReader(table.read_text(encoding="utf-8").splitlines())
        fields = yaml.safe_load(config.read_text(encoding="utf-8"))
        demonstrations = fields.get("demonstrations", {"num_transitions": 0})
        return int(last["transitions"]), int(demonstrations["num_transitions"])
    except (AttributeError, KeyError, TypeError, ValueError, csv.Error, yaml.YAMLError):
        raise ConfigError(
            f"run {path}: {table.name} and {config.name}: must be as the training wrote them"
        ) from None


def lock_run(path: Path) -> BinaryIO:
    """Make a run folder and lock it until the file is closed; a run has one process.

    Raises:
        ConfigError: another process is at work in it.
        OSError: it cannot be made or locked.
    """
    path.mkdir(parents=True, exist_ok=True)
    try:
        return lock_folder(path)
    except LockedError:
        raise ConfigError(
            f"output = {str(path)!r}: another process trains in it: wait for it, or end it"
        ) from None


def check_empty(path: Path) -> None:
    """Refuse a folder for a new run that holds something.

    Raises:
        ConfigError: it does, or it is a file, or in one.
    """
    files = [str(one) for one in (path, *path.parents) if one.is_file()]
    if files:
        raise ConfigError(f"output = {str(path)!r}: must be a folder; {files[0]} is a file")
    if path.exists() and any(entry.name != LOCK_FILE for entry in path.iterdir()):
        raise ConfigError(
            f"output = {str(path)!r}: must be a new or empty folder; a run that it holds "
            f"already can be continued with resume={path}"
        )


class RunFolder:
    """Paths and logs of one run; no other process may use the folder until it is closed.

    Args:
        path: the folder; made when missing.
        learned: columns of the algorithm in the table of metrics.
        evaluated: the metrics in the table of the saved models.
        extents: None for a new run, which needs an empty folder; for one that is resumed, where
            its tables ended when the training state was written. What is beyond is cut off.
        until: for one that is resumed, the transitions that it had made then.

    Raises:
        ConfigError: another process is at work in the folder, or it already holds a run.
        CheckpointError: a table is not the one that the training state is of.
        OSError: the folder cannot be written.
    """

    metrics: Table
    maneuvers: Table
    evaluations: Table

    def __init__(
        self,
        path: Path,
        learned: Sequence[str],
        *,
        evaluated: Sequence[str] = EVALUATED,
        extents: Mapping[str, Extent] | None = None,
        until: int = 0,
    ) -> None:
        self.path = path
        self._columns = {
            "metrics": ("transitions", "updates", *learned, "num_ended", "mean_return"),
            "maneuvers": ("transitions", "return", "outcome"),
            "evaluations": ("transitions", "checkpoint", *evaluated),
        }
        self._stack = ExitStack()
        self._stack.enter_context(lock_run(path))
        try:
            if extents is None:
                check_empty(path)
            else:
                for name in self._columns:
                    check_extent(self._table(name), extents.get(name))
        except BaseException:
            self.close()
            raise
        try:
            self._begin(extents or {}, None if extents is None else until + 1)
        except BaseException:
            self.close() if extents is not None else self.discard()
            raise

    def _begin(self, extents: Mapping[str, Extent], purge_step: int | None) -> None:
        self.checkpoints.mkdir(exist_ok=True)
        for name, columns in self._columns.items():
            table = Table(self._table(name), columns, extent=extents.get(name))
            self._stack.callback(table.close)
            setattr(self, name, table)
        self._board = SummaryWriter(str(self.path / "tensorboard"), purge_step=purge_step)
        self._stack.callback(self._board.close)

    def take_extents(self) -> dict[str, Extent]:
        """Where each table ends now; so much is on the disk."""
        return {name: getattr(self, name).take_extent() for name in self._columns}

    def _table(self, name: str) -> Path:
        return self.path / f"{name}.csv"

    @property
    def config(self) -> Path:
        """The run's configuration."""
        return self.path / CONFIG_FILE

    @property
    def checkpoints(self) -> Path:
        """The saved models."""
        return self.path / CHECKPOINTS_FOLDER

    def trajectory(self, checkpoint: str) -> Path:
        """The recorded road of a saved model's evaluation.

        Args:
            checkpoint: the model's file name.
        """
        return self.path / TRAJECTORIES_FOLDER / f"{Path(checkpoint).stem}.parquet"

    @property
    def film(self) -> Path:
        """The first, the final and the last saved model on the same road."""
        return self.path / FILM_FILE

    @property
    def state(self) -> Path:
        """What resuming needs."""
        return self.path / STATE_FILE

    @property
    def times(self) -> Path:
        """The seconds that the training took."""
        return self.path / TIMES_FILE

    @property
    def figures(self) -> Path:
        """The pictures."""
        return self.path / "figures"

    def choose_model(self, criterion: str) -> None:
        """Make the best of the saved models the final one; of equals the earliest.

        Its recorded road becomes that of the final one.

        Args:
            criterion: the metric that is highest for the best. A model without it is the worst.
        """
        with (self.path / EVALUATIONS_FILE).open(newline="", encoding="utf-8") as file:
            saved = {row["checkpoint"]: row[criterion] for row in csv.DictReader(file)}
        values = {name: float(value) if value else None for name, value in saved.items()}
        known = {name: -inf if value is None else value for name, value in values.items()}
        chosen = max(known, key=known.__getitem__)
        copy_file(self.checkpoints / chosen, self.checkpoints / FINAL_MODEL)
        if self.trajectory(chosen).exists():
            copy_file(self.trajectory(chosen), self.trajectory(FINAL_MODEL))
        write_json(self.path / CHOICE_FILE, {criterion: values, "chosen": chosen})

    def log(self, group: str, values: Mapping[str, Any], transitions: int) -> None:
        """Send numbers to TensorBoard."""
        for name, value in values.items():
            if isinstance(value, int | float):
                self._board.add_scalar(f"{group}/{name}", value, transitions)

    def close(self) -> None:
        """Close the logs, and let other processes use the folder."""
        self._stack.close()

    def discard(self) -> None:
        """Remove what a run left that could not begin, and the folder."""
        self.close()
        shutil.rmtree(self.path, ignore_errors=True)
