"""The training program of followers: one follower, turns with the changer, and what it refuses."""

import contextlib
import csv
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import torch
from omegaconf import OmegaConf
from programs import BUSY, load_program, replaced, run_main

from marl_lanes import Simulator, load_scenario
from marl_lanes.envs.followers import find_policies, load_follower
from marl_lanes.naf.checkpoint import read_checkpoint
from marl_lanes.traffic.roles.follower import FOLLOWER
from marl_lanes.training.checkpoint import (
    load_checkpoint,
    make_network,
    save_checkpoint,
)
from marl_lanes.training.config import ConfigError
from marl_lanes.trajectory.file import read_trajectory

torch.set_num_threads(1)

PROGRAM = Path(__file__).parents[2] / "agents" / "adversary" / "train.py"
SECTION = [
    "collector.num_envs=16",
    "collector.steps_per_batch=5",
    "collector.total_transitions=120",
    "replay.warmup_transitions=16",
    "replay.batch_size=8",
    "optimizer.transitions_per_update=4",
    "optimizer.pretraining_transitions=60",
    "evaluation.save_interval=50",
    "evaluation.num_maneuvers=2",
    "evaluation.final_num_maneuvers=4",
]
TINY = [
    "scenario=busy.yaml",
    "changer=changer.pt",
    "output=run",
    "training_overrides.warmup=[20.0,30.0]",
    "training_overrides.num_slots=4",
    "follower.hidden_sizes=[8]",
    *(f"{section}.{option}" for section in ("follower", "hardening") for option in SECTION),
    # Models that have learned so little differ in this alone.
    "hardening.evaluation.criterion=mean_max_follower_braking_all",
]
STATISTICS = {
    "success_rate",
    "completion_rate",
    "lost_after_rate",
    "abort_rate",
    "missed_rate",
    "collision_rate",
    "max_follower_braking_all",
}
PAPER = load_scenario("paper")
pytestmark = [
    pytest.mark.training,
    pytest.mark.filterwarnings(
        "ignore:Creating .* which inherits from WeightUpdaterBase:DeprecationWarning"
    ),
]


def prepare(folder):
    """A scenario, and a changer that finds its lane without training."""
    (folder / "busy.yaml").write_text(BUSY, encoding="utf-8")
    torch.manual_seed(0)
    save_checkpoint(folder / "changer.pt", make_network(PAPER, "damped", [8]), "busy", 0)
    return folder


def rows(path):
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def names(folder):
    return {path.name for path in folder.iterdir()}


def weights(path):
    return torch.load(path, weights_only=True)["weights"]


def is_same(one, other):
    return all(torch.equal(value, other[key]) for key, value in one.items())


def pairs(path):
    result = json.loads(path.read_text(encoding="utf-8"))
    return {(pair["changer"], pair["followers"]): pair["statistics"] for pair in result["pairs"]}


@pytest.fixture(scope="module")
def program():
    """The program as a module, in this process."""
    return load_program(PROGRAM)


def run_here(program, folder, *options):
    """Run the program in this process; what it prints."""
    out, _ = run_main(program, folder, *TINY, *options)
    return folder / "run", out


@pytest.fixture(scope="module")
def single(program, tmp_path_factory):
    """One follower against the changer as it is."""
    return run_here(program, prepare(tmp_path_factory.mktemp("single")))


@pytest.fixture(scope="module")
def turns(program, tmp_path_factory):
    """Two rounds without interruption."""
    return run_here(program, prepare(tmp_path_factory.mktemp("turns")), "rounds=2")


INPUTS = {"config.yaml", "scenario.yaml", "initial_changer.pt", "SHA256SUMS", ".lock"}
PHASE_FILES = {
    ".lock",
    "metrics.csv",
    "maneuvers.csv",
    "evaluations.csv",
    "training.json",
    "resume.pt",
    "checkpoints",
    "trajectories",
    "tensorboard",
}


def test_a_followers_run_folder_is_complete(single):
    run, _ = single
    assert names(run) == {*PHASE_FILES, *INPUTS, "evaluation.json"}
    recorded = read_trajectory(run / "trajectories" / "final.parquet")
    # The changer drives among followers that learn.
    assert recorded.metadata.policy == "changer.pt"
    assert np.isfinite(recorded.rows["follower_action"]).any()
    assert names(run / "trajectories") == {
        name.replace(".pt", ".parquet") for name in names(run / "checkpoints")
    }
    metrics = rows(run / "metrics.csv")
    assert int(metrics[-1]["transitions"]) >= 120
    assert {row["stage"] for row in metrics} == {"1", "2"}
    assert len(rows(run / "maneuvers.csv")) == sum(int(row["num_ended"]) for row in metrics)
    saved = rows(run / "evaluations.csv")
    assert len(saved) >= 3
    assert {row["checkpoint"] for row in saved} == names(run / "checkpoints")
    assert {"success_rate", "completion_rate", "abort_rate", "collision_rate"} < set(saved[0])
    assert OmegaConf.load(run / "config.yaml").follower.hidden_sizes == [8]


def test_a_follower_is_compared_with_the_scripted_ones(single):
    run, out = single
    found = pairs(run / "evaluation.json")
    followers = ["learned", "cooperative", "neutral", "adversarial"]
    assert list(found) == [("changer", name) for name in followers]
    assert all(set(statistics) >= STATISTICS for statistics in found.values())
    assert all(name in out for name in followers)


def test_the_follower_has_learned_and_drives(single, monkeypatch):
    run, _ = single
    first = min((run / "checkpoints").glob("step_*.pt"))
    final = run / "checkpoints" / "final.pt"
    assert read_checkpoint(final).scenario == "busy"
    assert not is_same(weights(first), weights(final))
    monkeypatch.chdir(run)
    learned = {"mix": {"learned": 1.0}, "learned": {"checkpoint": "checkpoints/final.pt"}}
    scenario = load_scenario("dense", {"followers": learned})
    simulator = Simulator(scenario, 2, follower_policies=find_policies(scenario), seed=0)
    simulator.reset()
    for _ in range(5):
        simulator.step(torch.zeros(2, scenario.num_slots, 1).numpy())


def test_turns_give_a_pool_a_hardened_changer_and_a_report(turns):
    run, out = turns
    assert names(run) == {*INPUTS, "round_1", "round_2", "pool", "changer.pt", "report.json"}
    for number in (1, 2):
        assert names(run / f"round_{number}") == {"follower", "changer"}
        assert names(run / f"round_{number}" / "follower") == PHASE_FILES
        assert names(run / f"round_{number}" / "changer") == {*PHASE_FILES, "choice.json"}
        follower = run / "pool" / f"pool_{number}.pt"
        trained = run / f"round_{number}" / "follower" / "checkpoints" / "final.pt"
        assert follower.read_bytes() == trained.read_bytes()
        load_follower(follower, PAPER)
    hardened = run / "round_2" / "changer" / "checkpoints" / "final.pt"
    assert (run / "changer.pt").read_bytes() == hardened.read_bytes()
    load_checkpoint(run / "changer.pt", PAPER)
    found = pairs(run / "report.json")
    kinds = ("cooperative", "neutral", "adversarial", "pool_1", "pool_2")
    assert list(found) == [(one, kind) for one in ("unhardened", "hardened") for kind in kinds]
    assert "hardened" in out


def test_the_changer_learns(turns):
    run, _ = turns
    for number in (1, 2):
        saved = sorted((run / f"round_{number}" / "changer" / "checkpoints").glob("step_*.pt"))
        assert not is_same(weights(saved[0]), weights(saved[-1]))


def test_the_best_changer_of_a_phase_is_chosen(program, turns):
    """The changer before the phase is one of them."""
    assert program.read(["changer=changer.pt"]).hardening.evaluation.criterion == "success_rate"
    run, _ = turns
    best = []
    for number in (1, 2):
        phase = run / f"round_{number}" / "changer"
        choice = json.loads((phase / "choice.json").read_text(encoding="utf-8"))
        values, chosen = choice["mean_max_follower_braking_all"], choice["chosen"]
        assert values[chosen] == max(values.values())
        assert {*values, "final.pt"} == names(phase / "checkpoints")
        final = phase / "checkpoints" / "final.pt"
        assert final.read_bytes() == (phase / "checkpoints" / chosen).read_bytes()
        best.append(chosen)
    assert best[0] != "step_000000000.pt"


def test_the_changer_goes_on_from_the_one_before(turns):
    """Stage one keeps mu: the second saved model of a phase has that of the phase's beginning."""
    run, _ = turns
    before = run.parent / "changer.pt"
    for number in (1, 2):
        folder = run / f"round_{number}" / "changer" / "checkpoints"
        first, second = sorted(folder.glob("step_*.pt"))[:2]
        assert first.name == "step_000000000.pt"
        assert 0 < torch.load(second, weights_only=True)["transitions"] < 120
        one, other = weights(before), weights(second)
        assert is_same(one, weights(first))
        assert not is_same(one, other)
        assert is_same({key: one[key] for key in one if key.startswith("mu.")}, other)
        before = folder / "final.pt"


def test_followers_of_two_rounds_are_not_the_same(turns):
    run, _ = turns
    one, other = (weights(run / "pool" / f"pool_{number}.pt") for number in (1, 2))
    assert not is_same(one, other)


def test_an_interrupted_run_goes_on_as_if_it_had_not_been(program, turns, tmp_path):
    reference, _ = turns
    process = subprocess.Popen(
        [sys.executable, str(PROGRAM), *TINY, "rounds=2"],
        cwd=prepare(tmp_path),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
        start_new_session=True,
    )
    run = tmp_path / "run"
    path = run / "round_1" / "changer" / "metrics.csv"
    deadline = time.monotonic() + 150
    while time.monotonic() < deadline and process.poll() is None:
        if path.exists() and len(path.read_bytes().splitlines()) > 1:
            break
        time.sleep(0.002)
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=300)
    assert process.returncode == 0, err[-3000:]
    assert "Traceback" not in err
    assert "resume=run" in out
    assert not (run / "round_2").exists()
    stamp = (run / "round_1" / "follower" / "resume.pt").stat().st_mtime_ns
    # It goes on from its folder alone; what a phase left that was killed at its beginning is gone.
    (tmp_path / "busy.yaml").unlink()
    save_checkpoint(tmp_path / "changer.pt", make_network(PAPER, "damped", [8]), "busy", 0)
    (run / "round_2" / "follower" / "checkpoints").mkdir(parents=True)
    with contextlib.chdir(tmp_path):
        program.main(["resume=run"])
    assert (run / "round_1" / "follower" / "resume.pt").stat().st_mtime_ns == stamp
    tables = sorted(path.relative_to(reference) for path in reference.rglob("*.csv"))
    assert len(tables) == 12
    choices = sorted(path.relative_to(reference) for path in reference.rglob("choice.json"))
    assert len(choices) == 2
    for name in [*tables, *choices, Path("report.json")]:
        assert (run / name).read_bytes() == (reference / name).read_bytes(), name
    for name in ("changer.pt", "pool/pool_1.pt", "pool/pool_2.pt"):
        assert is_same(weights(run / name), weights(reference / name)), name


def test_an_existing_run_is_refused(program, single, monkeypatch):
    run, _ = single
    monkeypatch.chdir(run.parent)
    before = {path: path.stat().st_mtime_ns for path in run.rglob("*")}
    for options in ([], ["rounds=2"]):
        with pytest.raises(ConfigError, match="output = 'run': must be a new or empty folder"):
            program.Run(given(program, *options))
    assert {path: path.stat().st_mtime_ns for path in run.rglob("*")} == before


def given(program, *options):
    """The configuration of the tiny budget and the options."""
    return program.read(replaced([*TINY, *options]))


def test_the_defaults_are_complete_and_in_range(program):
    config = program.read(["changer=changer.pt"])
    assert config.rounds == 0
    load_scenario(config.scenario, config.training_overrides)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["changer=null"], "changer = None: must be text"),
        (["objective=hostile"], "objective = 'hostile': must be 'adversarial' or 'coop"),
        (["rounds=-1"], "rounds = -1: must be greater than or equal to 0"),
        (["seed=-1"], "seed = -1: must be greater than or equal to 0"),
        (["+scripted.learned=0.1"], "scripted = .*: 'learned' must be among cooperative"),
        (["scripted.adversarial=-0.1"], "scripted.adversarial = -0.1: must be greater than"),
        (["scripted.adversarial=nan"], "scripted.adversarial = nan: must be a finite"),
        (["scripted.adversarial=0.9"], "scripted = .*: must be below 1 in all"),
        (["follower.hidden_sizes=[]"], r"follower.hidden_sizes = \[\]: must have"),
        (["follower.loss.gamma=2"], "follower.loss.gamma = 2: must be less than or equal"),
        (["hardening.collector.num_envs=0"], "hardening.collector.num_envs = 0: must be"),
        (["hardening.evaluation.seed=-1"], "hardening.evaluation.seed = -1: must be"),
        (["+training_overrides.road.lanes=3"], "road.lanes: unknown key"),
        (["training_overrides.command.probability=0"], "command.probability = 0: must be above"),
        (["scenario=nope"], "scenario 'nope': no such scenario"),
        (["resume=absent"], "resume = 'absent': must be alone"),
        (["changer=gone.pt"], "changer = 'gone.pt': .*gone.pt: cannot be read"),
        (["changer=zoo:nobody"], "changer = 'zoo:nobody': checkpoint zoo:nobody: no such policy"),
    ],
)
def test_what_is_refused_leaves_nothing_behind(program, tmp_path, monkeypatch, options, message):
    monkeypatch.chdir(prepare(tmp_path))
    with pytest.raises(ValueError, match=message) as caught:
        program.Run(given(program, *options))
    assert len(str(caught.value).splitlines()) == 1
    assert names(tmp_path) == {"busy.yaml", "changer.pt"}


@pytest.mark.parametrize(
    ("network", "message"),
    [
        (
            make_network(PAPER, "mlp", [8], role=FOLLOWER),
            "its features are .* the changers of scenario 'busy'",
        ),
        (
            make_network(load_scenario("paper", {"observation": {"features": ["speed"]}}), "mlp"),
            r"its features are \['speed'\], the changers of scenario 'busy' have \['speed', ",
        ),
        (
            make_network(load_scenario("paper", {"action": {"max_yaw_acceleration": 0.4}}), "mlp"),
            "its action bounds are .*0.4.*, the changers of scenario 'busy' have .*0.5",
        ),
    ],
    ids=["follower", "features", "bounds"],
)
def test_a_changer_that_does_not_fit_is_refused(program, tmp_path, monkeypatch, network, message):
    monkeypatch.chdir(prepare(tmp_path))
    save_checkpoint(tmp_path / "other.pt", network, "other", 0)
    with pytest.raises(ConfigError, match=r"^changer = 'other\.pt': .*other\.pt: " + message):
        program.Run(given(program, "changer=other.pt"))


def test_a_bad_value_is_one_error_and_no_folder(program, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(prepare(tmp_path))
    with pytest.raises(SystemExit) as caught:
        program.main([*TINY, "objective=hostile"])
    message = "error: objective = 'hostile': must be 'adversarial' or 'cooperative'"
    assert caught.value.code == 2
    assert capsys.readouterr() == ("", f"{message}\n")
    assert names(tmp_path) == {"busy.yaml", "changer.pt"}
