"""The training program of the other algorithms: its run, interruption, and what it refuses."""

import csv
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import torch
import yaml
from programs import BUSY, load_program, replaced, run_main

from marl_lanes import load_scenario
from marl_lanes.cli.main import main as command
from marl_lanes.training.checkpoint import load_policy

PROGRAM = Path(__file__).parents[2] / "agents" / "baselines" / "train.py"
TINY = [
    "td3",
    "scenario=busy.yaml",
    "output=run",
    "training_overrides.warmup=[20.0,30.0]",
    "network.hidden_sizes=[8]",
    "collector.num_envs=16",
    "collector.steps_per_batch=4",
    "collector.total_transitions=200",
    "replay.warmup_transitions=32",
    "replay.batch_size=8",
    "optimizer.transitions_per_update=2",
    "evaluation.save_interval=80",
    "evaluation.num_maneuvers=2",
    "evaluation.final_num_maneuvers=2",
    "evaluation.record=false",
]
TABLES = ("metrics.csv", "maneuvers.csv", "evaluations.csv", "evaluation.json")
pytestmark = [
    pytest.mark.training,
    pytest.mark.filterwarnings(
        "ignore:Creating .* which inherits from WeightUpdaterBase:DeprecationWarning"
    ),
]


def prepare(folder):
    """The folder, with the scenario in it."""
    (folder / "busy.yaml").write_text(BUSY, encoding="utf-8")
    return folder


def start(*options, folder):
    return subprocess.Popen(
        [sys.executable, str(PROGRAM), *options],
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
        start_new_session=True,
    )


@pytest.fixture(scope="module")
def program():
    """The program as a module, in this process."""
    return load_program(PROGRAM)


@pytest.fixture(scope="module")
def whole(program, tmp_path_factory):
    """An uninterrupted run, and what it prints."""
    folder = prepare(tmp_path_factory.mktemp("whole"))
    out, _ = run_main(program, folder, *TINY)
    return folder / "run", out


def test_a_run_is_reported_and_its_policy_evaluated(whole, monkeypatch, capsys):
    run, out = whole
    monkeypatch.chdir(run.parent)
    stored = yaml.safe_load((run / "config.yaml").read_text(encoding="utf-8"))
    assert (stored["algorithm"], stored["loss"]["actor_interval"]) == ("td3", 2)
    result = json.loads((run / "evaluation.json").read_text(encoding="utf-8"))
    assert result["num_maneuvers"] == 2
    assert "success_rate" in out
    assert len(list((run / "figures").iterdir())) == 8
    with (run / "metrics.csv").open(newline="", encoding="utf-8") as file:
        metrics = list(csv.DictReader(file))
    assert float(metrics[-1]["loss"]) > 0.0
    final = run / "checkpoints" / "final.pt"
    assert load_policy(final, load_scenario("busy.yaml")).transitions >= 200
    # The same maneuvers as the program's.
    arguments = ["--scenario", "busy.yaml", "--maneuvers", "2", "--seed", "1000000"]
    assert command(["evaluate", str(final), *arguments]) == 0
    assert f"{result['mean_episode_reward']:.5g}" in capsys.readouterr().out


def test_an_interrupted_run_goes_on_as_if_it_had_not_been(program, whole, tmp_path, monkeypatch):
    reference, _ = whole
    process = start(*TINY, folder=prepare(tmp_path))
    metrics = tmp_path / "run" / "metrics.csv"
    while process.poll() is None:
        if metrics.exists() and len(metrics.read_bytes().splitlines()) > 3:
            break
        time.sleep(0.005)
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=300)
    assert process.returncode == 0, err[-3000:]
    assert "continue with resume=run" in out
    assert not (tmp_path / "run" / "checkpoints" / "final.pt").exists()
    monkeypatch.chdir(tmp_path)
    program.main(["td3", "resume=run"])
    for name in TABLES:
        assert (tmp_path / "run" / name).read_bytes() == (reference / name).read_bytes(), name
    one, other = (
        torch.load(run / "resume.pt", weights_only=True)["loss"]
        for run in (reference, tmp_path / "run")
    )
    assert all(torch.equal(value, other[key]) for key, value in one.items())


def test_a_centralised_critic_is_trained_and_resumed(program, tmp_path, monkeypatch):
    """From the command line, where the environment has to have the state."""
    monkeypatch.chdir(prepare(tmp_path))
    absent = ("td3", "replay", "optimizer.transitions")
    tiny = [option for option in TINY if not option.startswith(absent)]
    arguments = ["mappo", *tiny, "epochs.batch_size=16"]
    learners = []
    with monkeypatch.context() as context:
        context.setattr(program, "run", lambda *given: learners.append(given[0]))
        program.main(replaced(arguments))
    (learner,) = learners
    assert learner.env.has_state
    for _ in range(3):
        learner.learn(learner.collect())
    learner.save()
    learner.close()
    # What comes after a training, the other tests look at.
    monkeypatch.setattr(program, "run", lambda *given: learners.append(given[0]))
    program.main(["mappo", "resume=run"])
    again = learners.pop()
    assert again.env.has_state
    assert again.transitions == learner.transitions
    again.learn(again.collect())
    again.close()
    with Path("run", "metrics.csv").open(newline="", encoding="utf-8") as file:
        metrics = list(csv.DictReader(file))
    assert float(metrics[-1]["loss"]) > 0.0
    assert int(metrics[-1]["transitions"]) > learner.transitions


@pytest.mark.parametrize(
    ("option", "message"),
    [
        ("loss.actor_interva=1", "loss.actor_interva: unknown key; did you mean actor_interval?"),
        ("loss.actor_interval=0", "loss.actor_interval = 0: must be greater than or equal to 1"),
        ("loss.distance=l3", "loss.distance = 'l3': must be 'l1', 'l2' or 'smooth_l1'"),
        ("scenario=nope", "scenario 'nope': no such scenario"),
        ("num_workers=2", "num_workers = 2: must be 1 with collector=single"),
        ("resume=absent", "resume = 'absent': must be alone"),
    ],
)
def test_a_bad_value_is_one_error_and_no_folder(
    program, tmp_path, monkeypatch, capsys, option, message
):
    monkeypatch.chdir(prepare(tmp_path))
    with pytest.raises(SystemExit) as caught:
        program.main(replaced([*TINY, option]))
    assert caught.value.code == 2
    err = capsys.readouterr().err
    assert err.startswith(f"error: {message}")
    assert len(err.splitlines()) == 1
    assert [path.name for path in tmp_path.iterdir()] == ["busy.yaml"]


def test_the_algorithm_is_named(program, capsys):
    for arguments in ([], ["ppo2"], ["--help"]):
        with pytest.raises(SystemExit):
            program.main(arguments)
    with pytest.raises(SystemExit):
        program.main(["td3", "--help"])
    found = capsys.readouterr()
    assert "choose from" in found.err
    assert "loss.actor_interval: updates of the critics" in found.out


def test_every_algorithm_has_its_numbers(program):
    files = {path.stem for path in PROGRAM.parent.glob("*.yaml")}
    assert files == {"config", *program.BASELINES}
    for name in program.BASELINES:
        config = program.read(name, [])
        assert config.algorithm == name
        load_scenario(config.scenario, config.training_overrides)
