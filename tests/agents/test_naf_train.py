"""The training program: its run folder, interruption, repetition, and runs that it refuses."""

import csv
import gc
import json
import shlex
import shutil
import signal
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pytest
import torch
from films import read_pictures
from kills import interrupt, kill, kill_within, run_until
from naf_program import (
    PROGRAM,
    TINY,
    UNRECORDED,
    assert_same_weights,
    begin,
    prepare,
    read_tiny,
    weights,
)
from omegaconf import OmegaConf
from programs import load_program, run_main

from marl_lanes import load_scenario
from marl_lanes.evaluation.metrics import summarise
from marl_lanes.evaluation.recording import record_road
from marl_lanes.naf.checkpoint import greedy_policy, read_checkpoint
from marl_lanes.recipes.naf import read
from marl_lanes.report.replays import RECORDING
from marl_lanes.training.checkpoint import (
    load_checkpoint,
)
from marl_lanes.trajectory.events import find_commands
from marl_lanes.trajectory.file import read_trajectory

pytestmark = pytest.mark.training
PAPER = load_scenario("paper")
collector_warnings = pytest.mark.filterwarnings(
    "ignore:Creating .* which inherits from WeightUpdaterBase:DeprecationWarning"
)
PNG = b"\x89PNG\r\n\x1a\n"
FIGURES = {
    f"{name}.{kind}"
    for name in ("loss", "returns", "saved_models", "first_and_last")
    for kind in ("svg", "png")
}


def rows(path):
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


@pytest.fixture(scope="module")
def program():
    """The program as a module, in this process."""
    return load_program(PROGRAM)


@pytest.fixture(scope="module")
def whole(program, tmp_path_factory):
    """An uninterrupted run, and what it prints."""
    folder = prepare(tmp_path_factory.mktemp("whole"))
    out, _ = run_main(program, folder, *TINY, "output=run")
    return folder / "run", out


def test_the_run_folder_is_complete(whole):
    run, _ = whole
    names = {path.name for path in run.iterdir()}
    assert names == {
        ".lock",
        "config.yaml",
        "scenario.yaml",
        "SHA256SUMS",
        "metrics.csv",
        "maneuvers.csv",
        "evaluations.csv",
        "evaluation.json",
        "final_maneuvers.csv",
        "training.json",
        "command.txt",
        "report.html",
        "resume.pt",
        "checkpoints",
        "trajectories",
        "figures",
        "film.mp4",
        "replays",
        "tensorboard",
    }
    assert {path.name for path in (run / "figures").iterdir()} == FIGURES
    for name in FIGURES:
        start = PNG if name.endswith(".png") else b"<?xml"
        assert (run / "figures" / name).read_bytes().startswith(start), name
        assert (run / "figures" / name).stat().st_size > 5000, name
    events = list((run / "tensorboard").glob("events.out.tfevents.*"))
    assert events
    assert sum(path.stat().st_size for path in events) > 500


def test_a_road_of_every_saved_model_is_recorded(whole):
    run, _ = whole
    for checkpoint in (run / "checkpoints").iterdir():
        trajectory = read_trajectory(run / "trajectories" / f"{checkpoint.stem}.parquet")
        assert trajectory.metadata.policy == f"checkpoints/{checkpoint.name}"
        assert (trajectory.scenario.name, trajectory.metadata.seed) == ("busy", 1_000_001)
        assert trajectory.roads == [0]
        assert len(find_commands(trajectory.rows)) == trajectory.scenario.num_agents
        policy = greedy_policy(load_checkpoint(checkpoint, trajectory.scenario).network)
        name = trajectory.metadata.policy
        again = record_road(trajectory.scenario, policy, seed=1_000_001, name=name)
        rows = again.rows[again.rows["step"] <= trajectory.rows["step"].max()]
        assert rows.tobytes() == trajectory.rows.tobytes()
    recorded = {path.stem for path in (run / "trajectories").iterdir()}
    saved = {path.stem for path in (run / "checkpoints").iterdir()}
    assert recorded == saved | {RECORDING}


def test_the_film_shows_two_models(whole):
    run, _ = whole
    pictures = read_pictures(run / "film.mp4")
    assert len(pictures) > 60
    assert (run / "film.mp4").stat().st_size < 3_000_000
    half = pictures.shape[1] // 2
    red = (pictures[0] @ np.array([2, -1, -1])).astype(int) > 200
    assert min(red[:half].sum(), red[half:].sum()) > 50


def test_the_tables(whole):
    run, _ = whole
    metrics = rows(run / "metrics.csv")
    transitions = [int(row["transitions"]) for row in metrics]
    assert transitions == sorted(transitions)
    assert transitions[-2] < 300 <= transitions[-1]
    # An update for each transition after the warm-up; stage one for 120 transitions.
    assert [int(row["updates"]) for row in metrics] == [max(0, t - 64) for t in transitions]
    before = [0, *transitions[:-1]]
    assert [int(row["stage"]) for row in metrics] == [1 if t < 120 else 2 for t in before]
    for row, start_ in zip(metrics, before, strict=True):
        sigma = 0.05 + min(1.0, start_ / 300) * (0.005 - 0.05)
        assert float(row["sigma"]) == pytest.approx(sigma, abs=1e-7)
    assert float(metrics[-1]["loss"]) > 0.0
    maneuvers = rows(run / "maneuvers.csv")
    assert len(maneuvers) == sum(int(row["num_ended"]) for row in metrics)
    saved = [now for last, now in zip(before, transitions, strict=True) if now // 100 > last // 100]
    evaluations = rows(run / "evaluations.csv")
    names = [*(f"step_{count:09d}.pt" for count in saved), "final.pt"]
    assert len(saved) >= 2
    assert [row["checkpoint"] for row in evaluations] == names
    assert [int(row["transitions"]) for row in evaluations] == [*saved, transitions[-1]]
    assert sorted(names) == sorted(path.name for path in (run / "checkpoints").iterdir())


def test_the_evaluation(whole):
    run, out = whole
    result = json.loads((run / "evaluation.json").read_text(encoding="utf-8"))
    assert result["num_maneuvers"] == 3
    assert (result["scenario"], result["seed"]) == ("busy", 1_000_000)
    assert result["policy"] == "checkpoints/final.pt"
    wanted = {
        "success_rate",
        "completion_rate",
        "collision_rate",
        "abort_rate",
        "missed_rate",
        "off_road_rate",
    }
    wanted |= {"mean_return", "mean_return_yaw_acceleration", "mean_return_yaw_rate"}
    wanted |= {"mean_return_deviation", "mean_optimal_return", "cost_ratio", "mean_duration"}
    assert wanted < set(result)
    added = {"scenario", "policy", "seed", "confidence", "intervals", "versions"}
    assert set(result) == {*added, *all_keys()}
    assert result["intervals"]["success_rate"]["value"] == result["success_rate"]
    assert result["versions"]["torch"] == version("torch")
    for key in wanted:
        assert key in out
    seconds = json.loads((run / "training.json").read_text(encoding="utf-8"))
    assert all(value >= 0.0 for value in seconds.values())
    assert len(seconds) >= 5


def test_the_report_and_what_it_stands_on(whole):
    run, _ = whole
    result = json.loads((run / "evaluation.json").read_text(encoding="utf-8"))
    maneuvers = rows(run / "final_maneuvers.csv")
    assert len(maneuvers) == 3
    successes = [int(row["is_success"]) for row in maneuvers]
    assert np.mean(successes) == result["success_rate"]
    assert [row["failure"] == "" for row in maneuvers] == [success == 1 for success in successes]
    page = (run / "report.html").read_text(encoding="utf-8")
    assert f"{sum(successes)} of 3 lane changes succeeded" in page
    assert page.count("<svg") == 4
    assert page.count("evaluation.final_num_maneuvers=3") == 1
    command = (run / "command.txt").read_text(encoding="utf-8")
    assert shlex.split(command) == ["python", "agents/naf/train.py", *TINY, "output=run"]


def all_keys():
    from test_docs import lane_change

    return summarise([lane_change()])


def test_the_stored_config_is_complete(whole):
    run, _ = whole
    stored = OmegaConf.load(run / "config.yaml")
    assert stored.collector.num_envs == 8
    assert stored.network.hidden_sizes == [8]
    assert stored.recipe == "fast"
    assert stored.loss.gamma == 0.998


def test_mu_is_frozen_in_stage_one_alone(whole):
    run, _ = whole
    steps = sorted((run / "checkpoints").glob("step_*.pt"))
    first, last = read_checkpoint(steps[0]), read_checkpoint(run / "checkpoints" / "final.pt")
    assert first.transitions < 150
    assert last.transitions >= 300
    assert last.scenario == "busy"
    load_checkpoint(run / "checkpoints" / "final.pt", load_scenario("paper"))
    before, after = (weights(run, name) for name in (steps[0].name, "final.pt"))
    assert any(not torch.equal(before[key], after[key]) for key in before if key.startswith("mu."))


SAME = (
    "*.csv",
    "checkpoints/*",
    "trajectories/*",
    "evaluation.json",
    "scenario.yaml",
    "SHA256SUMS",
    "command.txt",
)
"""The files of a run folder in which no seconds are."""


def contents(run):
    return {
        str(path.relative_to(run)): path.read_bytes() for name in SAME for path in run.glob(name)
    }


def test_a_run_that_is_stopped_goes_on_as_if_it_had_not_been(program, whole, tmp_path):
    """By Ctrl-C, a kill, and a kill within a write; then from its folder alone."""
    reference, _ = whole
    run = prepare(tmp_path) / "run"
    options = [*TINY, "output=run"]
    status, printed = run_until(program, tmp_path, options, 17, interrupt)
    assert (status, "Traceback" in printed) == (0, False), printed
    assert "interrupted; continue with resume=run" in printed
    assert not (run / "checkpoints" / "final.pt").exists()
    assert 3 <= len(rows(run / "metrics.csv")) < len(rows(reference / "metrics.csv"))
    (tmp_path / "busy.yaml").write_text("num_agents: 1\n", encoding="utf-8")
    status, printed = run_until(program, tmp_path, ["resume=run"], 7, kill_within(20_000))
    assert status == -signal.SIGXFSZ, printed
    status, printed = run_until(program, tmp_path, ["resume=run"], 9, kill)
    assert status == -signal.SIGKILL, printed
    (tmp_path / "busy.yaml").unlink()
    run_main(program, tmp_path, "resume=run")
    assert_same_files(run, reference)
    drawn = ("figures/loss.svg", "figures/saved_models.png")
    for name in drawn:
        assert (run / name).read_bytes() == (reference / name).read_bytes(), name
    assert {path.name for path in (run / "figures").iterdir()} == FIGURES


@pytest.mark.long
def test_a_run_that_is_killed_often_goes_on_as_if_it_had_not_been(program, whole, tmp_path):
    """At random writes, every second time within one."""
    reference, _ = whole
    run = prepare(tmp_path) / "run"
    generator = np.random.default_rng(0)
    for index in range(20):
        is_begun = (run / "resume.pt").exists()
        if not is_begun and run.exists():
            with pytest.raises(SystemExit):
                run_main(program, tmp_path, "resume=run")
            shutil.rmtree(run)
        options = ["resume=run"] if is_begun else [*TINY, "output=run"]
        act = kill_within(int(generator.integers(3000, 70_000))) if index % 2 else kill
        place = generator.integers(1, 20 if is_begun else 40)
        status, printed = run_until(program, tmp_path, options, place, act)
        # ffmpeg may be what the limit ends.
        is_killed = status in {-signal.SIGKILL, -signal.SIGXFSZ}
        assert is_killed or "ffmpeg could not write the film" in printed, printed[-3000:]
    assert (run / "resume.pt").exists()
    run_main(program, tmp_path, "resume=run")
    assert_same_files(run, reference)


def assert_same_files(run, reference):
    """Assert that all is equal in which there are no seconds, and nothing is left over."""
    found, wanted = contents(run), contents(reference)
    assert found.keys() == wanted.keys()
    assert [name for name in found if found[name] != wanted[name]] == []
    assert [path.name for path in run.rglob(".*")] == [".lock"]


def test_the_papers_recipe(program, whole, tmp_path):
    reference, _ = whole
    options = [UNRECORDED, "recipe=paper", "loss.target_interval=100", "seed=1", "output=paper"]
    run_main(program, prepare(tmp_path), *TINY, *options)
    run = tmp_path / "paper"
    assert OmegaConf.load(run / "config.yaml").loss.gamma == 0.95
    assert OmegaConf.load(run / "config.yaml").collector.num_envs == 8
    assert json.loads((run / "evaluation.json").read_text("utf-8"))["num_maneuvers"] == 3
    one, other = weights(reference), weights(run)
    assert any(not torch.equal(other[key], value) for key, value in one.items())


def test_an_existing_run_is_refused(program, whole, monkeypatch, capsys):
    run, _ = whole
    monkeypatch.chdir(run.parent)
    before = {path: path.stat().st_mtime_ns for path in run.rglob("*")}
    with pytest.raises(SystemExit) as caught:
        program.main([*TINY, "output=run"])
    assert caught.value.code == 2
    assert capsys.readouterr().err.startswith("error: output = 'run': must be a new or empty ")
    assert {path: path.stat().st_mtime_ns for path in run.rglob("*")} == before


def foreign_state(path):
    content = torch.load(path, weights_only=True)
    content["loss"] = {name: value for name, value in content["loss"].items() if "mu" not in name}
    torch.save(content, path)


@collector_warnings
@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("config.yaml", lambda path: replace(path, "seed: 0", "seed: 1"), "config.yaml must be as"),
        ("config.yaml", lambda path: path.write_bytes(b"{"), "its config.yaml"),
        ("config.yaml", lambda path: path.write_bytes(b"\xff"), "its config.yaml"),
        ("config.yaml", Path.unlink, "must be a run folder; it has no config.yaml"),
        ("scenario.yaml", lambda path: replace(path, "400.0", "401.0"), "scenario.yaml must be as"),
        ("scenario.yaml", Path.unlink, "must be a run folder; it has no scenario.yaml"),
        ("SHA256SUMS", Path.unlink, "its SHA256SUMS is damaged or gone"),
        ("resume.pt", Path.unlink, "resume.pt: there is none: the run was ended before it began"),
        ("resume.pt", lambda path: path.write_bytes(b"PK"), "resume.pt: not a training state"),
        ("resume.pt", foreign_state, "resume.pt: does not fit this run: weights: "),
        ("metrics.csv", lambda path: replace(path, "\n", ",\n"), "metrics.csv: must begin with"),
        ("evaluations.csv", Path.unlink, "evaluations.csv: must begin with the rows of the run"),
        (".lock", lambda path: (path.unlink(), path.mkdir()), "Is a directory"),
    ],
)
def test_a_run_that_is_broken_is_refused_in_a_line(
    whole, tmp_path, monkeypatch, name, change, message
):
    run, _ = whole
    monkeypatch.chdir(tmp_path)
    shutil.copytree(run, "run", ignore=shutil.ignore_patterns("figures", "tensorboard"))
    change(tmp_path / "run" / name)
    with pytest.raises((ValueError, OSError), match=message) as caught:
        begin(read(["resume=run"]))
    assert len(str(caught.value).splitlines()) == 1
    # A file that is still open, the lock among them, would be told here.
    del caught
    gc.collect()


def replace(path, old, new):
    path.write_text(path.read_text(encoding="utf-8").replace(old, new, 1), encoding="utf-8")


@collector_warnings
def test_a_training_starts_from_the_initial_checkpoint(whole, tmp_path, monkeypatch):
    run, _ = whole
    monkeypatch.chdir(prepare(tmp_path))
    initial = run / "checkpoints" / "final.pt"
    config = read_tiny(f"initial_checkpoint={initial}")
    learner = begin(config)
    assert learner.transitions == 0
    assert_same_weights(weights(run), learner.algorithm.network.state_dict())
    # The target network starts there as well.
    observation = torch.randn(5, 6)
    with learner.algorithm.loss.target_value_network_params.to_module(
        learner.algorithm.loss.value_network
    ):
        target = learner.algorithm.loss.value_network.max_value(observation)
    assert torch.equal(target, learner.algorithm.network.max_value(observation))
    learner.close()
    # What is resumed has weights of its own, and does not need the file again.
    config = config.model_copy(update={"initial_checkpoint": "gone.pt", "resume": "run"})
    learner = begin(config)
    assert_same_weights(weights(run), learner.algorithm.network.state_dict())
    learner.close()
