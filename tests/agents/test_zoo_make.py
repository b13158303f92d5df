"""The program that trains the zoo anew: order, measurements, files, and what it refuses."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from checkpoints import trained
from programs import BUSY, load_program

from marl_lanes import load_scenario
from marl_lanes.evaluation.benchmark import Row
from marl_lanes.traffic.roles.follower import FOLLOWER
from marl_lanes.training.checkpoint import make_network, save_checkpoint
from marl_lanes.zoo import index
from marl_lanes.zoo.index import find_entry, find_file, read_index

PROGRAM = Path(__file__).parents[2] / "agents" / "zoo" / "make.py"
MAKE = load_program(PROGRAM)
ADVERSARY = ("changer=zoo:one", "follower.evaluation.record=false")
CONFIG = "demonstrations: {num_transitions: 70}"
ROLES = {"changer": ("one", None), "follower": ("one", "rude")}


def policy(role, program, seed, *arguments):
    changer, follower = ROLES[role]
    trial = MAKE.Trial(changer, "busy.yaml", follower)
    return MAKE.Policy(f"A {role}.", role, program, seed, arguments, (trial,))


POLICIES = {
    # Named first, trained last.
    "rude": policy("follower", MAKE.ADVERSARY, 3, *ADVERSARY),
    "one": policy("changer", MAKE.NAF, 2, "scenario=busy.yaml"),
}
QUICK = ["--output", "runs", "--zoo", "zoo", "--maneuvers", "2"]


@pytest.fixture
def studies(tmp_path, monkeypatch):
    """What the program has carried out; trained in no time, in the working folder."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "busy.yaml").write_text(BUSY, encoding="utf-8")
    monkeypatch.setattr(MAKE, "POLICIES", POLICIES)
    done = []

    def carry_out(runs, folder, *, num_processes):
        done.append((runs, num_processes))
        for run in runs:
            network = trained("damped", load_scenario("busy.yaml"))
            if run.name == "rude":
                torch.manual_seed(0)
                network = make_network(load_scenario("busy.yaml"), "mlp", [8], role=FOLLOWER)
            save_checkpoint(folder / run.name / MAKE.MODEL, network, "busy", 300)
            times = json.dumps({"seconds_training": 1.5})
            (folder / run.name / "training.json").write_text(times, encoding="utf-8")
            table = "transitions\n300\n900\n"
            (folder / run.name / "evaluations.csv").write_text(table, encoding="utf-8")
            (folder / run.name / "config.yaml").write_text(CONFIG, encoding="utf-8")
        return True

    monkeypatch.setattr(MAKE, "carry_out", carry_out)
    return done


@pytest.mark.training
def test_opponents_are_trained_first_and_all_is_written(capsys, monkeypatch, studies, tmp_path):
    MAKE.main([*QUICK, "--processes", "3"])
    (first, number), (second, _) = studies
    assert number == 3
    assert first == [MAKE.Run("one", MAKE.NAF, ("scenario=busy.yaml", "seed=2"))]
    model = tmp_path / "runs" / "one" / MAKE.MODEL
    arguments = (f"changer={model}", ADVERSARY[1], "seed=3")
    assert second == [MAKE.Run("rude", MAKE.ADVERSARY, arguments)]
    monkeypatch.setattr(index, "FOLDER", tmp_path / "zoo")
    assert list(read_index()) == ["rude", "one"]
    assert find_file("zoo:one").read_bytes() == model.read_bytes()
    entry = find_entry("rude")
    assert (entry["role"], entry["seed"]) == ("follower", 3)
    assert entry["training"] == {
        "scenario": "busy",
        "transitions": 900,
        "demonstrations": 70,
        "seconds": 1.5,
        "command": "python agents/adversary/train.py changer=zoo:one "
        "follower.evaluation.record=false seed=3",
    }
    (row,) = map(Row.model_validate, entry["rows"])
    assert (row.policy, row.task) == ("zoo:one", "busy.yaml, followers learned:zoo:rude")
    assert (row.num_maneuvers, row.seed) == (2, 2_000_000)
    shown = [line.partition(": success")[0] for line in capsys.readouterr().out.splitlines()]
    assert shown == [
        "rude: zoo:one on busy.yaml, followers learned:zoo:rude",
        "one: zoo:one on busy.yaml",
    ]


@pytest.mark.training
def test_what_was_measured_is_not_driven_again(monkeypatch, studies, tmp_path):
    MAKE.main([*QUICK, "--only", "one"])
    assert [run.name for runs, _ in studies for run in runs] == ["one"]
    # With --only nothing is written there.
    assert not (tmp_path / "zoo").exists()

    class DrivenError(Exception):
        pass

    def drive(*_, **__):
        raise DrivenError

    monkeypatch.setattr(MAKE, "measure_row", drive)
    MAKE.main([*QUICK, "--only", "one"])
    with pytest.raises(DrivenError):
        MAKE.main([*QUICK, "--only", "one", "--maneuvers", "3"])
    # Nor is anything written where a measurement fails.
    with pytest.raises(DrivenError):
        MAKE.main(QUICK)
    assert not (tmp_path / "zoo").exists()


@pytest.mark.training
def test_a_policy_that_is_no_longer_made_is_removed(monkeypatch, studies, tmp_path):
    MAKE.main(QUICK)
    assert len(studies) == 2
    (tmp_path / "zoo" / "mine.pt").write_text("of somebody", encoding="utf-8")
    monkeypatch.setattr(MAKE, "POLICIES", {"one": POLICIES["one"]})
    MAKE.main(QUICK)
    assert {path.name for path in (tmp_path / "zoo").iterdir()} == {"one.pt", "mine.pt", "zoo.json"}


def test_an_interruption_writes_nothing(capsys, monkeypatch, studies, tmp_path):
    monkeypatch.setattr(MAKE, "carry_out", lambda *_, **__: False)
    MAKE.main(QUICK)
    assert capsys.readouterr().out == "interrupted; the same command goes on\n"
    assert not studies
    assert not (tmp_path / "zoo").exists()


def test_a_file_that_is_too_large_is_refused(capsys, monkeypatch, studies, tmp_path):
    monkeypatch.setattr(MAKE, "MAX_SIZE", 1000)
    with pytest.raises(SystemExit, match="2"):
        MAKE.main(QUICK)
    assert "final.pt: must have at most 1,000 bytes" in capsys.readouterr().err
    assert studies
    assert not (tmp_path / "zoo").exists()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--processes", "0"], "--processes 0: must be at least 1"),
        (["--maneuvers", "-1"], "--maneuvers -1: must be at least 1"),
        (["--only", "nobody"], "nobody"),
        (["--quick"], "--quick: must have --zoo or --only"),
    ],
)
def test_bad_calls_are_one_line(capsys, options, message):
    with pytest.raises(SystemExit, match="2"):
        MAKE.main(options)
    error = capsys.readouterr().err
    assert message in error
    assert len(error.splitlines()) == 1


@pytest.mark.parametrize("is_quick", [False, True])
def test_every_training_gets_a_field_once(is_quick, tmp_path):
    options = [*["--quick"][: int(is_quick)], "--zoo", str(tmp_path), "--output", str(tmp_path)]
    zoo = MAKE.Zoo(MAKE.parse(options))
    for name, given in MAKE.POLICIES.items():
        run = zoo._run(name)
        fields = [argument.partition("=")[0] for argument in run.arguments]
        assert len(fields) == len(set(fields)), name
        assert {one.partition("=")[0] for one in given.arguments} <= set(fields)
        if is_quick:
            assert {*MAKE.QUICK[run.program]} <= {*run.arguments}


def test_every_opponent_is_a_policy_and_every_one_fits_where_it_is_measured():
    for policy in MAKE.POLICIES.values():
        assert policy.others <= set(MAKE.POLICIES)
        assert policy.trials
        for trial in policy.trials:
            load_scenario(trial.scenario)


@pytest.mark.long
def test_all_are_trained_by_their_programs(tmp_path):
    command = [sys.executable, str(PROGRAM), "--quick", *QUICK]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    found = json.loads((tmp_path / "zoo" / "zoo.json").read_text(encoding="utf-8"))
    assert list(found) == list(MAKE.POLICIES)
    assert {path.stem for path in (tmp_path / "zoo").glob("*.pt")} == set(found)
