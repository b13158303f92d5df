"""The folder of a training run: config, tables, checkpoints, trajectories, figures."""

import csv
from collections.abc import Mapping, Sequence
from math import inf
from pathlib import Path
from typing import Any

from torch.utils.tensorboard import SummaryWriter

from marl_lanes.files import copy_file, write_atomically, write_json
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


class Table:
    """A CSV file that grows row by row; its first column is the number of transitions."""

    def __init__(self, path: Path, columns: Sequence[str], *, until: int | None = None) -> None:
        """Begin the table anew, or go on with its rows of at most ``until`` transitions.

        The row of the final model is never kept: it is written again when the run ends.
        """
        self.columns = tuple(columns)
        kept: list[list[str]] = []
        if until is not None:
            with path.open(newline="", encoding="utf-8") as file:
                rows = list(csv.reader(file))[1:]
            # A row cut short by a crash has no end; none of it counts.
            whole = [row for row in rows if len(row) == len(self.columns)]
            kept = [row for row in whole if int(row[0]) <= until and FINAL_MODEL not in row]

        def write(temporary: Path) -> None:
            with temporary.open("w", newline="", encoding="utf-8") as file:
                csv.writer(file).writerows([self.columns, *kept])

        write_atomically(path, write)
        self._file = path.open("a", newline="", encoding="utf-8")
        self._writer = csv.writer(self._file)

    def append(self, *rows: Sequence[Value]) -> None:
        """Add rows, values in the order of the columns."""
        self._writer.writerows(rows)
        self._file.flush()

    def close(self) -> None:
        """Close the file."""
        self._file.close()


def check_empty(path: Path) -> None:
    """Refuse a folder for a new run that holds something.

    Raises:
        ConfigError: it does, or it is a file, or in one.
    """
    files = [str(one) for one in (path, *path.parents) if one.is_file()]
    if files:
        raise ConfigError(f"output = {str(path)!r}: must be a folder; {files[0]} is a file")
    if path.exists() and any(path.iterdir()):
        raise ConfigError(
            f"output = {str(path)!r}: must be a new or empty folder; a run that it holds "
            f"already can be continued with resume={path}"
        )


class RunFolder:
    """Paths and logs of one run.

    Args:
        path: the folder; made when missing.
        learned: columns of the algorithm in the table of metrics.
        until: None for a new run, which needs an empty folder; for one that is resumed, the
            transitions of its checkpoint, beyond which the logs are cut off.
        evaluated: the metrics in the table of the saved models.

    Raises:
        ConfigError: a new run's folder already holds a run.
    """

    def __init__(
        self,
        path: Path,
        learned: Sequence[str],
        *,
        until: int | None = None,
        evaluated: Sequence[str] = EVALUATED,
    ) -> None:
        self.path = path
        if until is None:
            check_empty(path)
        self.checkpoints.mkdir(parents=True, exist_ok=True)
        self.metrics = Table(
            path / "metrics.csv",
            ("transitions", "updates", *learned, "num_ended", "mean_return"),
            until=until,
        )
        self.maneuvers = Table(
            path / "maneuvers.csv", ("transitions", "return", "outcome"), until=until
        )
        self.evaluations = Table(
            path / EVALUATIONS_FILE,
            ("transitions", "checkpoint", *evaluated),
            until=until,
        )
        self._board = SummaryWriter(
            str(path / "tensorboard"), purge_step=None if until is None else until + 1
        )

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
        """The first and the last saved model side by side."""
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
        """Close the logs."""
        for table in (self.metrics, self.maneuvers, self.evaluations):
            table.close()
        self._board.close()
