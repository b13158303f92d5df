"""Train the policies of the zoo anew, measure them, and write their files and the index.

python agents/zoo/make.py [--output runs/zoo] [--only NAME ...] [--processes N] [--maneuvers N]
    [--zoo FOLDER] [--quick]

The same command goes on with what was interrupted: finished trainings and measurements are kept.
Nothing is written to the zoo before all are measured; with --only nothing is written there.
"""

import argparse
import hashlib
import json
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

from tqdm import tqdm

from marl_lanes import load_scenario
from marl_lanes.evaluation.benchmark import Row, measure_row
from marl_lanes.evaluation.tasks import NUM_MANEUVERS, SEED
from marl_lanes.files import copy_file, write_json
from marl_lanes.naf.checkpoint import greedy_policy, read_content
from marl_lanes.scenario.dispositions import LEARNED
from marl_lanes.scenario.messages import shown
from marl_lanes.studies import Run, carry_out
from marl_lanes.terminal import lenient_streams
from marl_lanes.training.checkpoint import load_policy
from marl_lanes.training.command_line import Parser, refusing
from marl_lanes.training.config import ConfigError
from marl_lanes.training.failures import ending
from marl_lanes.training.run_folder import (
    CHECKPOINTS_FOLDER,
    FINAL_MODEL,
    TIMES_FILE,
    count_transitions,
)
from marl_lanes.zoo.index import FOLDER, INDEX_FILE, PREFIX

NAF, ADVERSARY = "agents/naf/train.py", "agents/adversary/train.py"
MODEL = f"{CHECKPOINTS_FOLDER}/{FINAL_MODEL}"
MAX_SIZE = 200_000
"""[bytes] Of a policy's file."""
MAX_COUNT = 10**6


class Trial(NamedTuple):
    """What a policy of the zoo is measured on.

    Args:
        changer: its name in the zoo.
        scenario: a shipped one.
        follower: the name of a learned follower in the zoo, None for the scenario's followers.
    """

    changer: str
    scenario: str
    follower: str | None = None


class Policy(NamedTuple):
    """How a policy of the zoo is made. ``zoo:NAME`` in its arguments is one made by this command.

    Args:
        description: one line.
        role: changer or follower.
        program: that trains it.
        seed: of the training.
        arguments: of the program, besides the seed.
        trials: what is measured, the main one first.
    """

    description: str
    role: str
    program: str
    seed: int
    arguments: tuple[str, ...]
    trials: tuple[Trial, ...]

    @property
    def opponents(self) -> set[str]:
        """The policies of the zoo that must be trained before this one."""
        values = (one.partition("=")[2] for one in self.arguments)
        return {one.removeprefix(PREFIX) for one in values if one.startswith(PREFIX)}

    @property
    def others(self) -> set[str]:
        """The policies of the zoo that must be trained before this one is measured."""
        measured = {
            name for trial in self.trials for name in (trial.changer, trial.follower) if name
        }
        return self.opponents | measured

    @property
    def command(self) -> str:
        """The command line that trains it."""
        return " ".join(["python", self.program, *self.arguments, f"seed={self.seed}"])


POLICIES = {
    "paper": Policy(
        "Lane changer (NAF, recipe fast) on the paper's highway; also fits dense, five_lanes and "
        "adversarial.",
        "changer",
        NAF,
        0,
        ("scenario=paper", "evaluation.record=false"),
        (
            Trial("paper", "paper"),
            Trial("paper", "dense"),
            Trial("paper", "adversarial"),
        ),
    ),
    "interactive": Policy(
        "Lane changer (NAF, recipe interactive) that steers and accelerates in dense adversarial "
        "traffic.",
        "changer",
        NAF,
        0,
        ("scenario=interactive", "evaluation.record=false"),
        (Trial("interactive", "interactive"),),
    ),
    "adversary": Policy(
        "Follower that has learned to hinder zoo:interactive.",
        "follower",
        ADVERSARY,
        0,
        (
            f"changer={PREFIX}interactive",
            "follower.evaluation.save_interval=600_000",
            "follower.evaluation.final_num_maneuvers=100",
            "follower.evaluation.record=false",
        ),
        (Trial("interactive", "interactive", "adversary"),),
    ),
}

_LEARNING = (
    "collector.num_envs=8",
    "collector.steps_per_batch=4",
    "collector.total_transitions=300",
    "replay.warmup_transitions=64",
    "replay.batch_size=16",
    "optimizer.transitions_per_update=8",
    "optimizer.pretraining_transitions=100",
    "evaluation.save_interval=300",
    "evaluation.num_maneuvers=2",
    "evaluation.final_num_maneuvers=2",
)
QUICK: Mapping[str, tuple[str, ...]] = {
    NAF: (*_LEARNING, "demonstrations.num_transitions=0"),
    ADVERSARY: tuple(f"follower.{one}" for one in _LEARNING),
}
"""What --quick sets of the arguments of a program: a budget that shows only that all works. No
demonstrations: not every scenario has them."""


@lenient_streams()
def main(arguments: Sequence[str] | None = None) -> None:
    """Train, measure, write."""
    options = parse(arguments)
    zoo = Zoo(options)
    with ending(zoo.output), refusing():
        if not zoo.train():
            print("interrupted; the same command goes on")
            return
        index = {name: zoo.describe(name) for name in zoo.names}
        if not options.only:
            zoo.write(index)
    for name, entry in index.items():
        for row in entry["rows"]:
            success, cost = (
                row["statistics"][key]["value"] for key in ("success_rate", "cost_ratio")
            )
            ratio = "-" if cost is None else f"{cost:.3f}"
            print(f"{name}: {row['policy']} on {row['task']}: success {success:.2%}, ratio {ratio}")


class Zoo:
    """The policies while they are made: a folder of runs, and of what was measured.

    Args:
        options: the command line.
    """

    def __init__(self, options: argparse.Namespace) -> None:
        self.options = options
        self.output: Path = options.output.resolve()
        self.names: list[str] = options.only or list(POLICIES)

    def train(self) -> bool:
        """Carry out the trainings, those of opponents first; False when interrupted."""
        left = set(self.names)
        while more := set[str]().union(*(POLICIES[name].others for name in left)) - left:
            left |= more
        while left:
            ready = [
                name for name in POLICIES if name in left and not POLICIES[name].opponents & left
            ]
            runs = list(map(self._run, ready))
            if not carry_out(runs, self.output, num_processes=self.options.processes):
                return False
            left -= set(ready)
        return True

    def describe(self, name: str) -> dict[str, Any]:
        """The entry of the index: what is known of a trained policy."""
        policy, file = POLICIES[name], self._model(name)
        if file.stat().st_size > MAX_SIZE:
            raise ConfigError(f"{file}: must have at most {MAX_SIZE:,} bytes")
        transitions, demonstrations = count_transitions(self.output / name)
        times = json.loads((self.output / name / TIMES_FILE).read_text(encoding="utf-8"))
        return {
            "description": policy.description,
            "role": policy.role,
            "sha256": _digest(file),
            "version": version("marl-lanes"),
            "seed": policy.seed,
            "training": {
                "scenario": read_content(file)["scenario"],
                "transitions": transitions,
                "demonstrations": demonstrations,
                "seconds": times["seconds_training"],
                "command": policy.command,
            },
            "rows": [self._measure(trial) for trial in policy.trials],
        }

    def write(self, index: Mapping[str, Mapping[str, Any]]) -> None:
        """Put the files and then the index into the zoo."""
        folder: Path = self.options.zoo
        file = folder / INDEX_FILE
        before = json.loads(file.read_text(encoding="utf-8")) if file.is_file() else {}
        for name in index:
            copy_file(self._model(name), folder / f"{name}.pt")
        write_json(file, index)
        for name in before.keys() - index.keys():
            (folder / f"{name}.pt").unlink()

    def _run(self, name: str) -> Run:
        policy = POLICIES[name]
        quick = QUICK[policy.program] if self.options.quick else ()
        # A program takes a field once.
        short = {_field_of(argument) for argument in quick}
        arguments = [
            self._place(argument)
            for argument in policy.arguments
            if _field_of(argument) not in short
        ]
        return Run(name, policy.program, (*arguments, f"seed={policy.seed}", *quick))

    def _place(self, argument: str) -> str:
        """The argument, with the file of the policy that zoo:NAME stands for."""
        field, _, value = argument.partition("=")
        is_of_zoo = value.startswith(PREFIX)
        return f"{field}={self._model(value.removeprefix(PREFIX))}" if is_of_zoo else argument

    def _model(self, name: str) -> Path:
        return self.output / name / MODEL

    def _measure(self, trial: Trial) -> dict[str, Any]:
        """The row of a trial, from its file if it was measured before."""
        names = [trial.changer, *([trial.follower] if trial.follower else [])]
        models = {name: _digest(self._model(name)) for name in names}
        file = self.output / "measured" / f"{'_'.join([trial.scenario, *names])}.json"
        number: int = self.options.maneuvers
        if file.is_file():
            known = json.loads(file.read_text(encoding="utf-8"))
            if (known["models"], known["row"]["num_maneuvers"]) == (models, number):
                return dict(known["row"])
        row = self._drive(trial, number).model_dump(mode="json")
        write_json(file, {"models": models, "row": row})
        return row

    def _drive(self, trial: Trial, number: int) -> Row:
        task, followers = trial.scenario, {}
        if trial.follower is not None:
            task += f", followers learned:{PREFIX}{trial.follower}"
            checkpoint = str(self._model(trial.follower))
            followers = {"mix": {LEARNED: 1.0}, LEARNED: {"checkpoint": checkpoint}}
        scenario = load_scenario(trial.scenario, {"followers": followers})
        policy = greedy_policy(load_policy(self._model(trial.changer), scenario).network)
        name = PREFIX + trial.changer
        with tqdm(total=2 * number, unit="maneuver", desc=f"{name} on {task}") as bar:
            return measure_row(
                name,
                task,
                scenario,
                policy,
                number,
                seed=SEED,
                progress=lambda count: bar.update(count - bar.n),
            )


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _field_of(argument: str) -> str:
    return argument.partition("=")[0]


def parse(arguments: Sequence[str] | None = None) -> argparse.Namespace:
    """The command line."""
    parser = Parser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--output", type=Path, default=Path("runs/zoo"), help="of the runs (default: runs/zoo)"
    )
    parser.add_argument(
        "--only", nargs="+", choices=list(POLICIES), help="train and measure these, write nothing"
    )
    parser.add_argument("--processes", type=int, default=1, help="trainings at a time (default: 1)")
    parser.add_argument(
        "--maneuvers",
        type=int,
        default=NUM_MANEUVERS,
        help=f"that each is measured on (default: {NUM_MANEUVERS})",
    )
    parser.add_argument(
        "--zoo", type=Path, default=FOLDER, help="to write (default: the package's)"
    )
    parser.add_argument(
        "--quick", action="store_true", help="a budget that shows only that all works"
    )
    options = parser.parse_args(arguments)
    for name in ("processes", "maneuvers"):
        value = getattr(options, name)
        if not 1 <= value <= MAX_COUNT:
            parser.error(f"--{name} {shown(value)}: must be at least 1, at most {MAX_COUNT}")
    if options.quick and not options.only and options.zoo.resolve() == FOLDER.resolve():
        parser.error("--quick: must have --zoo or --only: its policies are good for nothing")
    return options


if __name__ == "__main__":
    main()
