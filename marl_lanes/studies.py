"""Many trainings by one command: each a program of agents/ in a process, with a folder of its own.

What is finished is skipped, what is begun is resumed, so the same call carries on a study that was
interrupted in any way.
"""

import os
import shlex
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from tqdm import tqdm

from marl_lanes.scenario.messages import shown
from marl_lanes.training.config import ConfigError
from marl_lanes.training.failures import TrainingError
from marl_lanes.training.interruptions import note_interruptions
from marl_lanes.training.run_folder import COMMAND_FILE, EVALUATION_FILE, STATE_FILE

RESULTS = (EVALUATION_FILE, "report.json")
"""What a program writes last of all that is computed: either says that the run is finished."""

_PAUSE = 0.1
"""[s] Between two looks at the processes."""

_TOLD = "30"
"""[s] Between two lines of a bar in a log."""

_APART: Mapping[str, Any]
"""How a process is started that the terminal's Ctrl-C does not reach."""
if sys.platform == "win32":
    _APART = {"creationflags": subprocess.CREATE_NEW_PROCESS_GROUP}
else:
    _APART = {"start_new_session": True}


class Run(NamedTuple):
    """One training of a study.

    Args:
        name: of its folder.
        program: that trains, a path in the repository: ``agents/naf/train.py``. It takes
            ``output=DIR``, and ``resume=DIR`` beside arguments that are no fields.
        arguments: its command line, without these two.
    """

    name: str
    program: str
    arguments: tuple[str, ...]


def carry_out(runs: Sequence[Run], folder: Path, *, num_processes: int = 1) -> bool:
    """Bring every run to its end, in ``folder/NAME``; ``folder/NAME.log`` has what it prints.

    Ctrl-C (or SIGTERM, SIGHUP) lets each running one write its training state; a second one stops
    them at once.

    Args:
        runs: the trainings, in the order in which they begin.
        folder: of the study; other processes may carry out other runs in it.
        num_processes: trainings at a time.

    Returns:
        whether all are finished; False when it was interrupted.

    Raises:
        ConfigError: a name, a program or the number cannot be, or a run was begun by another
            command; nothing has been begun then.
        TrainingError: runs have failed; all others are finished.
        OSError: a folder or a log cannot be written.
    """
    if num_processes < 1:
        raise ConfigError(f"processes = {num_processes}: must be at least 1")
    programs = _check(runs, folder)
    folder.mkdir(parents=True, exist_ok=True)
    waiting = [run for run in runs if not is_finished(folder / run.name)]
    running: dict[str, subprocess.Popen[bytes]] = {}
    failures: list[str] = []
    is_told = False
    with (
        note_interruptions() as interrupted,
        tqdm(total=len(runs), initial=len(runs) - len(waiting), unit="run", desc="study") as bar,
    ):
        try:
            while running or (waiting and not interrupted):
                while waiting and len(running) < num_processes and not interrupted:
                    run = waiting.pop(0)
                    running[run.name] = _start(run, programs[run.program], folder)
                    bar.set_postfix_str(", ".join(running))
                time.sleep(_PAUSE)
                if interrupted and not is_told:
                    _interrupt(running)
                    is_told = True
                for name in [name for name, one in running.items() if one.poll() is not None]:
                    status = running.pop(name).returncode
                    if is_finished(folder / name):
                        bar.update()
                    else:
                        failures.append(_explain(name, status, folder))
        except KeyboardInterrupt:
            return False
        finally:
            _interrupt(running)
            for process in running.values():
                process.wait()
    if failures and not interrupted:
        raise TrainingError("; ".join(failures))
    return all(is_finished(folder / run.name) for run in runs)


def is_finished(path: Path) -> bool:
    """Whether the run in this folder has its final evaluation."""
    return any((path / name).exists() for name in RESULTS)


def _check(runs: Sequence[Run], folder: Path) -> Mapping[str, Path]:
    """Where the programs are; refuse runs that cannot be carried out."""
    names = [run.name for run in runs]
    for run in runs:
        if names.count(run.name) > 1 or Path(run.name).name != run.name:
            raise ConfigError(f"run {shown(run.name)}: must be the name of one folder, of one run")
        file = folder / run.name / COMMAND_FILE
        if not file.is_file():
            continue  # a new one, or a folder that the program refuses
        words = shlex.split(file.read_text(encoding="utf-8"))
        given = [word for word in words if not word.startswith("output=")]
        wanted = ["python", run.program, *run.arguments]
        if given != wanted:
            raise ConfigError(
                f"run {folder / run.name}: must have been begun by {shlex.join(wanted)!r}, and was "
                f"by {shlex.join(given)!r}: choose another output"
            )
    return {run.program: _find(run.program) for run in runs}


def _find(program: str) -> Path:
    """A file of the repository that the started program, or else this package, lies in."""
    above = [*Path(sys.argv[0]).resolve().parents, *Path(__file__).resolve().parents]
    for parent in above:
        if (parent / program).is_file():
            return parent / program
    raise ConfigError(f"program {shown(program)}: must be a file of the repository")


def _start(run: Run, program: Path, folder: Path) -> subprocess.Popen[bytes]:
    """Begin a run, or resume it, out of the reach of the terminal's Ctrl-C."""
    path = folder / run.name
    if any(path.rglob(STATE_FILE)):
        # The rest is in the folder.
        words = [word for word in run.arguments if "=" not in word]
        options = [*words, f"resume={path}"]
    else:
        if (path / COMMAND_FILE).exists():
            # What this run has left that was killed before its first training state.
            shutil.rmtree(path)
        options = [*run.arguments, f"output={path}"]
    with (folder / f"{run.name}.log").open("ab") as log:
        return subprocess.Popen(  # noqa: S603
            [sys.executable, str(program), *options],
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=subprocess.STDOUT,
            env={"TQDM_MININTERVAL": _TOLD, **os.environ},
            **_APART,
        )


def _interrupt(running: Mapping[str, subprocess.Popen[bytes]]) -> None:
    for process in running.values():
        if sys.platform == "win32":
            try:
                process.send_signal(signal.CTRL_BREAK_EVENT)
            except OSError:
                # Without a console nothing can ask it: it goes on from what it has saved.
                process.terminate()
        else:
            # SIGINT is ignored by all that a shell has put into the background.
            process.terminate()


def _explain(name: str, status: int, folder: Path) -> str:
    """Why a run has failed: the last line that it printed."""
    log = folder / f"{name}.log"
    lines = log.read_text(encoding="utf-8", errors="replace").splitlines()
    last = next((line for line in reversed(lines) if line.strip()), "")
    return f"run {name} ended with status {status}: {last.strip()} (all in {log})"
