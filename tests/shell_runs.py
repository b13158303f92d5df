"""Commands of the pages, run in this process with budgets that show only that they work."""

import argparse
import atexit
import contextlib
import io
import re
import runpy
import shlex
import shutil
import subprocess
import sys
import tempfile
import tomllib
import traceback
from functools import cache
from pathlib import Path
from typing import NamedTuple

import pytest
from doc_pages import FILES, ROOT
from programs import BUSY, replaced

from marl_lanes import studies
from marl_lanes.cli.main import INTERRUPTED, main

LEARNING = (
    "collector.num_envs=8",
    "collector.steps_per_batch=4",
    "collector.total_transitions=150",
    "evaluation.save_interval=150",
    "evaluation.num_maneuvers=1",
    "evaluation.final_num_maneuvers=1",
    "evaluation.record=false",
)
OFF_POLICY = (*LEARNING, "replay.warmup_transitions=64", "replay.batch_size=16")
STAGES = (
    *OFF_POLICY,
    "optimizer.transitions_per_update=8",
    "optimizer.pretraining_transitions=80",
)
WARMUP = "++training_overrides.warmup=[20.0,30.0]"
NAF = (
    *STAGES,
    WARMUP,
    "demonstrations.num_transitions=100",
    "demonstrations.num_updates=2",
)
FOLLOWER = (WARMUP, *(f"follower.{one}" for one in STAGES))
LEAGUE = (
    *FOLLOWER,
    *(f"hardening.{one}" for one in STAGES),
    "generations=1",
    "followers=[adversarial]",
    "held_out=[brake-checker]",
)
QUICK = {
    r"agents/naf/train\.py|marl-lanes train": NAF,
    r"agents/baselines/train\.py (ippo|mappo)": (*LEARNING, WARMUP),
    r"agents/baselines/train\.py (sac|td3|ddpg)": (*OFF_POLICY, WARMUP),
    r"agents/adversary/train\.py": FOLLOWER,
    r"agents/adversary/league\.py": LEAGUE,
    r"agents/zoo/make\.py": ("--quick", "--maneuvers=2", "--zoo=zoo"),
    r"agents/naf/ablate\.py": ("--quick", "--seeds=0", "--only=base"),
    r"agents/naf/reproduce\.py": ("--quick", "--seeds=0", "--scenarios=touch"),
    r"agents/baselines/compare\.py": ("--quick", "--seeds=0", "--seconds=0", "--algorithms=ippo"),
    r"agents/memory/compare\.py": ("--seeds=0", "--transitions=150", "--views=gru"),
    r"agents/memory/recognise\.py": ("--roads=8", "--seconds=60", "--updates=2"),
    r"agents/cascade/tune\.py": ("--generations=1", "--population=2", "--roads=2", "--seconds=60"),
    r"agents/irl/recover\.py": ("--maneuvers=2", "--candidates=2", "--rounds=1", "--samples=10"),
    r"benchmarks/soak\.py": ("--vehicle-steps=1e4", "--roads=1"),
    r"marl-lanes (evaluate|crossplay|benchmark) ": ("--maneuvers=1",),
    r"marl-lanes followers ": ("--maneuvers=20",),
    r"marl-lanes record .*\.(mp4|gif)": ("--speed=10",),
}
"""By what is in a command: the arguments that make it quick. They replace those of its fields."""
TWO_MODELS = {"agents/naf/train.py": ("evaluation.save_interval=75",)}
"""Of the trainings of studies, which compare saved models."""
AT_HAND = {
    "rush.yaml": BUSY,
    "my/rush.yaml": BUSY,
    "others.json": (ROOT / "docs" / "benchmark" / "mpc.json").read_text(encoding="utf-8"),
    **FILES,
}
"""Files of the reader's own, beside those that the pages show: what a page says they stand for."""
RUN = "runs/paper"


class CommandError(Exception):
    """A command does not work as a page shows it."""


class Result(NamedTuple):
    """What a command has left."""

    status: int
    out: str
    err: str


def run(line, folder):
    """Run a command line in a folder, with its pipe and its redirection.

    Raises:
        CommandError: it ends with another status than 0.
    """
    words = shlex.split(line)
    target = mode = None
    if len(words) > 2 and words[-2] in (">", ">>"):
        mode, target = ("a" if words[-2] == ">>" else "w"), words[-1]
        words = words[:-2]
    stages = [[]]
    for word in words:
        if word == "|":
            stages.append([])
        else:
            stages[-1].append(word)
    out = run_words(stages[0], folder)
    for stage in stages[1:]:
        # What reads the output is another program, which not every computer has.
        if shutil.which(stage[0]) is not None:
            done = subprocess.run(
                stage, input=out, capture_output=True, text=True, check=False, cwd=folder
            )
            if done.returncode:
                raise CommandError(f"{line}: {done.stderr}")
    if target is not None:
        path = folder / re.sub("^~", "home", target)
        with path.open(mode, encoding="utf-8") as file:
            file.write(out)


def run_words(words, folder):
    """Run a program of the repository; what it prints."""
    program, *arguments = words
    name = Path(program).name
    if name == "make":
        return "".join(run_words(shlex.split(one), folder) for one in recipe_of(words, folder))
    if name not in ("marl-lanes", "python"):
        raise CommandError(f"{shlex.join(words)}: is neither run here nor among what is not run")
    provide(arguments, folder)
    arguments = quicken(name, expand(arguments, folder))
    result = call(name, arguments, folder)
    # Ctrl-C is the only end of what serves.
    if result.status not in ((0, INTERRUPTED) if arguments[:1] == ["watch"] else (0,)):
        raise CommandError(f"{shlex.join([name, *arguments])}: {result.status}: {tail(result.err)}")
    return result.out


def provide(words, folder):
    """Write what the words name and the reader has, unless a command of the page has made it."""
    given = [word for word in words if not word.startswith("output=")]
    for name, text in AT_HAND.items():
        module = Path(name).stem if name.endswith(".py") else None
        named = [word for word in given if word.partition(":")[0] == module or name in word]
        if named and not (folder / name).exists():
            (folder / name).parent.mkdir(exist_ok=True)
            (folder / name).write_text(text, encoding="utf-8")
    if any(RUN in word for word in given) and not (folder / RUN).exists():
        shutil.copytree(trained(), folder / RUN)


@cache
def trained():
    """The run folder that ``make train`` leaves."""
    folder = Path(tempfile.mkdtemp())
    atexit.register(shutil.rmtree, folder)
    lay_out(folder)
    arguments = replaced([*NAF, f"output={RUN}", "evaluation.record=true"])
    result = call("python", ["agents/naf/train.py", *arguments], folder)
    assert result.status == 0, tail(result.err)
    return folder / RUN


def lay_out(folder):
    """Copy into the folder what the reader of a page has in the repository's."""
    for path in ROOT.iterdir():
        if path.is_file():
            shutil.copy(path, folder)
    for name in ("agents", "benchmarks", "docs", "scenarios"):
        left_out = shutil.ignore_patterns("__pycache__", "*.png", "*.svg", "*.gif")
        shutil.copytree(ROOT / name, folder / name, ignore=left_out)
    (folder / "home" / ".config" / "fish" / "completions").mkdir(parents=True)


def quicken(name, arguments):
    """The arguments, with those that make the command quick."""
    text = f"{name} {' '.join(arguments)} "
    if "resume=" in text:
        return arguments
    for pattern, quick in QUICK.items():
        if re.search(pattern, text):
            is_of_fields = not quick[0].startswith("--")
            return replaced([*arguments, *quick]) if is_of_fields else [*arguments, *quick]
    return arguments


def expand(words, folder):
    """The words, those with a star as the files that they stand for."""
    found = []
    for word in words:
        files = sorted(folder.glob(word)) if "*" in word else []
        found += [one.relative_to(folder).as_posix() for one in files] or [word]
    return found


def recipe_of(words, folder):
    """The programs of the repository that a command of make would run."""
    text = (folder / "Makefile").read_text(encoding="utf-8")
    for word in words[1:]:
        variable, is_set, _ = word.partition("=")
        if is_set and not re.search(rf"^{variable} \?=", text, re.MULTILINE):
            raise CommandError(f"{shlex.join(words)}: the Makefile has no {variable}")
    done = subprocess.run(
        ["make", "--dry-run", *words[1:]], cwd=folder, capture_output=True, text=True, check=False
    )
    if done.returncode:
        raise CommandError(f"{shlex.join(words)}: {done.stderr}")
    lines = done.stdout.replace("\\\n", " ").splitlines()
    return [line for line in lines if re.match(r"\S*python agents/", line)]


def call(name, arguments, folder):
    """Run ``marl-lanes`` or a Python program in this process."""
    out, err = io.StringIO(), io.StringIO()
    with (
        restored(folder),
        contextlib.chdir(folder),
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
    ):
        try:
            status = main(arguments) if name == "marl-lanes" else run_program(*arguments)
        except SystemExit as end:
            status = end.code
            if isinstance(status, str):
                err.write(status)
                status = 1
        except ParsedError:
            raise
        except Exception:
            err.write(traceback.format_exc())
            status = 1
    return Result(status or 0, out.getvalue(), err.getvalue())


def run_program(path, *arguments):
    """Run a Python program as Python does, in the present folder."""
    sys.argv = [path, *arguments]
    sys.path.insert(0, str(Path(path).parent.resolve()))
    runpy.run_path(path, run_name="__main__")


@contextlib.contextmanager
def restored(folder):
    """Forget afterwards the arguments, the search path, and the modules of the folder."""
    argv, path = sys.argv, list(sys.path)
    # Another test's modules of the same names would be found instead of the folder's.
    names = {file.stem for file in folder.glob("*.py")} & set(sys.modules)
    others = {name: sys.modules.pop(name) for name in names}
    modules = set(sys.modules)
    try:
        yield
    finally:
        sys.argv, sys.path[:] = argv, path
        for name in set(sys.modules) - modules:
            file = getattr(sys.modules[name], "__file__", None)
            if file is not None and Path(file).is_relative_to(folder):
                del sys.modules[name]
        sys.modules.update(others)


def carry_out(runs, folder, *, num_processes=1):
    """The trainings of a study, one after the other in this process."""
    assert num_processes > 0
    folder.mkdir(parents=True, exist_ok=True)
    for one in runs:
        if not studies.is_finished(folder / one.name):
            words = [*one.arguments, f"output={folder / one.name}"]
            given = [*quicken("python", [one.program, *words]), *TWO_MODELS.get(one.program, ())]
            result = call("python", replaced(given), Path.cwd())
            if result.status:
                raise CommandError(f"{one.name}: {tail(result.err)}")
    return True


def tail(err):
    """The end of what a program has printed, without its bars."""
    return "\n".join(line.rpartition("\r")[2] for line in err.splitlines()[-12:])


class ParsedError(Exception):
    """A command line has been read, and nothing was done."""


def configure(line, folder):
    """Compose and print the configuration of a training, and do not train."""
    words = shlex.split(line)
    provide(words, folder)
    name = Path(words[0]).name
    result = call(name, [*words[1:], "--cfg", "job"], folder)
    if result.status:
        raise CommandError(f"{line}: {result.err}")


def parse(line, folder):
    """Read a command line by the program's own parser, and do nothing."""
    words = shlex.split(line)
    name = Path(words[0]).name
    with pytest.MonkeyPatch.context() as patch:
        for method in ("parse_args", "parse_intermixed_args"):
            patch.setattr(argparse.ArgumentParser, method, stopping(method))
        try:
            result = call(name, words[1:], folder)
        except ParsedError:
            return
    raise CommandError(f"{line}: {result.err}")


def stopping(method):
    """The method of a parser, after which the program does not go on."""
    read = getattr(argparse.ArgumentParser, method)

    def read_and_stop(*arguments, **options):
        read(*arguments, **options)
        raise ParsedError

    return read_and_stop


def look_up(line, _):
    """Look for the files of the repository and the extras that a command names."""
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    for word in shlex.split(line.replace("\\", "/")):
        if re.search(r"\.(txt|toml|py)$|^\.ci/", word) and not (ROOT / word).is_file():
            raise CommandError(f"{line}: there is no {word}")
        for extra in re.findall(r"(?<=\[)[^\]]+", word):
            if not set(extra.split(",")) <= set(extras["optional-dependencies"]):
                raise CommandError(f"{line}: there is no extra {extra}")


def make(line, folder):
    """Ask make what it would do."""
    recipe_of(shlex.split(line), folder)
