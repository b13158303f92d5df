"""Benchmarks that train, render or verify run to their end; speeds need an idle machine."""

import importlib
import json
import runpy
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from marl_lanes import Simulator, list_scenarios

BENCHMARKS = Path(__file__).parents[1] / "benchmarks"


@pytest.mark.training
def test_a_policy_step_and_the_split_of_a_training(tmp_path):
    file = tmp_path / "figures.json"
    program = [sys.executable, str(BENCHMARKS / "policy_step.py")]
    options = ["--rounds", "1", "--transitions", "500", "--json", str(file)]
    done = subprocess.run([*program, *options], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    figures = json.loads(file.read_text(encoding="utf-8"))
    assert [row["slots"] for row in figures["slots"]] == [4, 16, 64]
    assert set(figures["split"]) == {"fast", "paper", "interactive"}
    for split in figures["split"].values():
        microseconds, share = split["simulate"]
        assert microseconds > 0.0
        assert 0.0 < share < 1.0


@pytest.mark.training
def test_the_pictures_of_a_second(tmp_path):
    file = tmp_path / "figures.json"
    program = [sys.executable, str(BENCHMARKS / "rendering.py")]
    options = ["--rounds", "1", "--json", str(file)]
    done = subprocess.run([*program, *options], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    figures = json.loads(file.read_text(encoding="utf-8"))
    for size in ("1280x720", "600x180"):
        row = figures[f"parallel_env {size}"]
        assert 1.0 < row["with_steps"] < row["alone"]
        assert f"{size} " in done.stdout


def run(name, *arguments):
    """The program's names, and its exit code, in this process."""
    names = runpy.run_path(str(BENCHMARKS / f"{name}.py"))
    return names, names["main"]([str(argument) for argument in arguments])


@pytest.mark.training
@pytest.mark.parametrize("mu", ["cascade", "paper"])
def test_a_training_on_one_device(tmp_path, capsys, mu):
    """On the CPU: what is measured on a GPU is the same."""
    file = tmp_path / "figures.json"
    sizes = ("collector.num_envs=16", "collector.total_transitions=600", "replay.batch_size=16")
    begin = ("replay.warmup_transitions=400", "optimizer.pretraining_transitions=500")
    ends = ("evaluation.save_interval=300", "evaluation.num_maneuvers=2", f"network.mu={mu}")
    often = "optimizer.transitions_per_update=8"
    run("gpu_training", "device=cpu", *sizes, *begin, *ends, often, "--json", file)
    figures = json.loads(file.read_text(encoding="utf-8"))
    assert figures["training: updates"] > 10
    assert figures["training: transitions"] >= 600
    assert figures["training: seconds"] > 0.0
    assert figures["training: seconds of compiling and capturing updates"] > 0.0
    (seconds,) = (value for name, value in figures.items() if name.startswith("seconds to"))
    if mu == "cascade":
        # This structure drives well from the beginning.
        assert figures["untrained: cost ratio"] < 1.1
        assert seconds == 0.0
        assert 0.0 < figures["final model: success rate"] <= 1.0
    else:
        assert figures["untrained: cost ratio"] == "none succeeds"
        assert seconds == "not reached"
    printed = capsys.readouterr().out
    assert all(name in printed for name in figures)


def count_kernels(file, *options):
    program = [sys.executable, str(BENCHMARKS / "naf_update.py"), "--kernels", "--json", str(file)]
    done = subprocess.run([*program, *options], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    kernels = json.loads(file.read_text(encoding="utf-8"))["kernels"]
    assert all(name in done.stdout for name in kernels)
    return kernels


@pytest.mark.training
def test_the_kernels_of_an_update(tmp_path):
    """An update on a GPU takes as long as its kernels are many."""
    kernels = count_kernels(tmp_path / "figures.json", "--eager")
    plain, batched = kernels["plain"], kernels["batched"]
    assert batched["drawing"] == plain["drawing"] <= 3.5
    assert batched["forward"] <= 44 < plain["forward"]
    assert batched["backward"] <= 45 < plain["backward"]
    assert batched["optimiser"] <= 2
    assert batched["target"] == 1


@pytest.mark.long
def test_the_kernels_of_a_compiled_update(tmp_path):
    kernels = count_kernels(tmp_path / "figures.json")
    batched = kernels["batched compiled"]
    assert batched["forward"] <= 15
    assert batched["backward"] <= 13
    assert sum(batched.values()) <= 34


@pytest.mark.slow
@pytest.mark.parametrize("compiles", [False, True])
def test_the_tables_of_a_gpu(tmp_path, capsys, monkeypatch, compiles):
    """With the CPU in its place, and a torch that may not compile: what it prints and writes."""
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    gpu = importlib.import_module("gpu")
    if not gpu.torch.cuda.is_available():
        with pytest.raises(SystemExit) as caught:
            gpu.main([])
        assert caught.value.code == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert line.startswith("error: ")
    sizes = []
    roads = SimpleNamespace(team_size=8, form_teams=sizes.append)
    monkeypatch.setattr(Simulator, "gpu_roads", roads)
    monkeypatch.setattr(gpu.torch.cuda, "get_device_name", lambda _: "a card")
    took = iter(range(1, 10**6))

    def measure_training(options, *, is_evaluated=True):
        if "optimizer.compile=true" in options and not compiles:
            raise gpu.TorchDynamoException("no C compiler\nand more of it")
        row = {"training: seconds": 2.5, "an update of 8: us": 120.0}
        return row | ({gpu.SECONDS_TO_GOOD: "not reached"} if is_evaluated else {})

    for name, stand_in in {
        "DEVICE": "cpu",
        "ENVS": (4, 6),
        "FEW_ENVS": 4,
        "capture": lambda call: call,
        "advance": lambda env: env.simulator.advance(),
        "check_gpu": lambda: None,
        "measure_training": measure_training,
        "measure_bandwidth": lambda: 1e12,
        "time_on_gpu": lambda call, _: (call(), 1e-3 * next(took))[1],
    }.items():
        monkeypatch.setattr(gpu, name, stand_in)
    file = tmp_path / "figures.json"
    assert gpu.main(["--json", str(file), "--no-tests"]) == 0
    figures = json.loads(file.read_text(encoding="utf-8"))
    few, more = figures["rows"]
    assert few["num_envs"] == 4
    # They took turns: 1 4 7 10 13 ms, 2 5 8 11 14 ms, 3 6 9 12 15 ms.
    found = [few[f"{name}_ms"] for name in ("step", "env_graph", "env")]
    assert found == pytest.approx([7.0, 8.0, 9.0])
    assert few["vehicle_steps_per_second"] == pytest.approx(4 * few["vehicles_per_road"] / 7e-3)
    assert 0.0 < few["share_of_limit"] < 1.0
    assert more["step_ms"] == pytest.approx(22.0)
    assert set(figures["team_ms"]["4"]) == {"1", "2", "4", "8", "16", "32"}
    assert sizes == [1, 2, 4, 8, 16, 32] * len(figures["team_ms"])
    assert set(figures["cpu"]) == {"Simulator", "LaneChangeEnv"}
    printed = capsys.readouterr().out
    assert printed.startswith("a card; a copy moves 1.00 TB/s")
    assert "10^9 vehicle-steps/s, best batch" in printed
    ends = [line.split()[-1] for line in printed.splitlines() if "  target " in line]
    # Models are evaluated once, after the first training that there is.
    if compiles:
        assert gpu.SECONDS_TO_GOOD in figures["trainings"]["a compiled training"]
        assert gpu.SECONDS_TO_GOOD not in figures["trainings"]["a training"]
        assert ends[-5:] == ["holds", "MISSED", "MISSED", "holds", "MISSED"]
    else:
        assert figures["trainings"]["a compiled training"] == {"error": "no C compiler"}
        assert ends[-3:] == ["holds", "MISSED", "MISSED"]


@pytest.mark.slow
def test_halving_the_time_step_halves_the_error(tmp_path):
    file, figure = tmp_path / "figures.json", tmp_path / "figure.svg"
    names, code = run("convergence", "--json", file, "--figure", figure)
    assert code == 0
    motions = json.loads(file.read_text(encoding="utf-8"))["motions"]
    assert len(motions) == 4
    for motion in motions.values():
        assert motion["orders"] == pytest.approx([1.0] * 4, abs=0.2)
        assert motion["orders"][-1] == pytest.approx(1.0, abs=names["TOLERANCE"])
    assert figure.read_bytes().startswith(b"<?xml")


SOAK = "--vehicle-steps", "1e5", "--roads", "2"


@pytest.mark.slow
def test_a_soak_of_all_scenarios(tmp_path, capsys):
    file = tmp_path / "figures.json"
    names, code = run("soak", *SOAK, "--json", file)
    assert code == 0
    figures = json.loads(file.read_text(encoding="utf-8"))
    assert figures["vehicle_steps"] >= 1e5
    assert figures["violations"] == {}
    assert len(figures["scenarios"]) == 2 * len(list_scenarios())
    assert all(row["vehicle_steps"] > 0 for row in figures["scenarios"].values())
    assert figures["memory"]
    assert "million vehicle-steps" in capsys.readouterr().err
    assert names["Memory"]([(0, 0), (10**6, 5), (2 * 10**6, 105), (3 * 10**6, 205)]).slope == (
        pytest.approx(100.0)
    )


SPOILS = {
    "not finite": lambda road: road.vehicles["yaw"].__setitem__((0, first(road)), np.nan),
    "negative speed": lambda road: road.vehicles["speed"].__setitem__((0, first(road)), -1.0),
    "vehicles not conserved": lambda road: road.roads["num_left"].__iadd__(1),
    "order": lambda road: road.vehicles["position"].__setitem__((0, first(road)), -1.0),
    "commands": lambda road: road.roads["num_live"].__iadd__(1),
}


def first(road):
    """Slot of the vehicle at the front."""
    return road.state.order[0, 0]


@pytest.mark.parametrize("name", SPOILS)
def test_a_soak_finds_what_is_wrong(name):
    find_violations = runpy.run_path(str(BENCHMARKS / "soak.py"))["find_violations"]
    road = Simulator("dense", seed=3)
    road.reset()
    assert not find_violations(road).total()
    SPOILS[name](road)
    found = +find_violations(road)
    assert set(found) == {name}


def test_a_soak_that_is_ended_gives_its_result_so_far(monkeypatch, capsys):
    def end(self, *actions):
        if (self.roads["step"] >= 60).any():
            raise KeyboardInterrupt
        step(self, *actions)

    step = Simulator.step
    monkeypatch.setattr(Simulator, "step", end)
    _, code = run("soak", "--vehicle-steps", "1e6", "--roads", "1")
    assert code == 130
    assert "ended by Ctrl-C" in capsys.readouterr().out
