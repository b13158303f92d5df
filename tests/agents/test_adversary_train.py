"""The training program of followers: its run folder, its comparison, and what it refuses."""

import json
import shutil

import numpy as np
import pytest
import torch
from adversary_program import (
    FOLDER,
    INPUTS,
    PAPER,
    PHASE_FILES,
    TINY,
    is_same,
    names,
    pairs,
    prepare,
    rows,
    weights,
)
from omegaconf import OmegaConf
from programs import load_program, replaced, run_main

from marl_lanes import Simulator, load_scenario
from marl_lanes.envs.followers import find_policies
from marl_lanes.naf.checkpoint import read_checkpoint
from marl_lanes.traffic.roles.follower import FOLLOWER
from marl_lanes.training.algorithms.actor_critic import ActorNetwork
from marl_lanes.training.checkpoint import make_network, save_checkpoint
from marl_lanes.training.config import ConfigError
from marl_lanes.trajectory.file import read_trajectory

torch.set_num_threads(1)

STATISTICS = {
    "success_rate",
    "completion_rate",
    "lost_after_rate",
    "abort_rate",
    "missed_rate",
    "collision_rate",
    "max_follower_braking_all",
}
pytestmark = [
    pytest.mark.training,
    pytest.mark.filterwarnings(
        "ignore:Creating .* which inherits from WeightUpdaterBase:DeprecationWarning"
    ),
]


@pytest.fixture(scope="module")
def program():
    """The program as a module, in this process."""
    return load_program(FOLDER / "train.py")


@pytest.fixture(scope="module")
def single(program, tmp_path_factory):
    """One follower against the changer as it is."""
    folder = prepare(tmp_path_factory.mktemp("single"))
    out, _ = run_main(program, folder, *TINY)
    return folder / "run", out


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


def test_an_existing_run_is_refused(program, single, monkeypatch):
    run, _ = single
    monkeypatch.chdir(run.parent)
    before = {path: path.stat().st_mtime_ns for path in run.rglob("*")}
    with pytest.raises(ConfigError, match="output = 'run': must be a new or empty folder"):
        program.prepare(given(program))
    assert {path: path.stat().st_mtime_ns for path in run.rglob("*")} == before


def test_a_finished_run_is_compared_again_from_its_folder_alone(program, single, tmp_path):
    run, _ = single
    shutil.copytree(run, tmp_path / "run")
    (tmp_path / "run" / "evaluation.json").unlink()
    run_main(program, tmp_path, "resume=run")
    found = (tmp_path / "run" / "evaluation.json").read_text(encoding="utf-8")
    assert pairs(tmp_path / "run" / "evaluation.json") == pairs(run / "evaluation.json")
    assert json.loads(found)["checkpoints"] == {"changer": "run/initial_changer.pt"}


def test_the_changer_may_be_of_another_algorithm(program, tmp_path, monkeypatch):
    monkeypatch.chdir(prepare(tmp_path))
    _, changer = program.prepare(given(program, "changer=actor.pt"))
    assert type(changer) is ActorNetwork


def given(program, *options):
    """The configuration of the tiny budget and the options."""
    return program.read(replaced([*TINY, *options]))


def test_the_defaults_are_complete_and_in_range(program):
    config = program.read(["changer=changer.pt"])
    assert config.objective == "adversarial"
    load_scenario(config.scenario, config.training_overrides)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["changer=null"], "changer = None: must be text"),
        (["objective=hostile"], "objective = 'hostile': must be 'adversarial' or 'coop"),
        (["seed=-1"], "seed = -1: must be greater than or equal to 0"),
        (["follower.hidden_sizes=[]"], r"follower.hidden_sizes = \[\]: must have"),
        (["follower.evaluation.seed=-1"], "follower.evaluation.seed = -1: must be"),
        (["follower.loss.gamma=2"], "follower.loss.gamma = 2: must be less than or equal"),
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
        program.prepare(given(program, *options))
    assert len(str(caught.value).splitlines()) == 1
    assert names(tmp_path) == {"busy.yaml", "changer.pt", "actor.pt"}


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
        program.prepare(given(program, "changer=other.pt"))


def test_a_bad_value_is_one_error_and_no_folder(program, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(prepare(tmp_path))
    with pytest.raises(SystemExit) as caught:
        program.main([*TINY, "objective=hostile"])
    message = "error: objective = 'hostile': must be 'adversarial' or 'cooperative'"
    assert caught.value.code == 2
    assert capsys.readouterr() == ("", f"{message}\n")
    assert names(tmp_path) == {"busy.yaml", "changer.pt", "actor.pt"}
