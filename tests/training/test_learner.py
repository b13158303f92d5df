"""One group's learning: its noise, its rows, and that it goes on as if it had not stopped."""

import shutil
import sys

import pytest
import torch
from learners import TWO_ACTIONS, Evaluation, changers, filled, followers, rows, tables, weights_of

from marl_lanes.extras import MissingExtraError
from marl_lanes.naf.checkpoint import read_checkpoint
from marl_lanes.training.config import ConfigError

torch.set_num_threads(1)
pytestmark = [
    pytest.mark.training,
    pytest.mark.filterwarnings(
        "ignore:Creating .* which inherits from WeightUpdaterBase:DeprecationWarning"
    ),
]


@pytest.mark.parametrize("make", [changers, followers])
def test_it_learns_from_its_beginning_to_the_final_model(tmp_path, make):
    learner = make()
    before = {key: value.clone() for key, value in learner.algorithm.network.state_dict().items()}
    learner.begin(tmp_path / "run")
    evaluation = Evaluation()
    assert learner.train(evaluation)
    learner.close()
    metrics = rows(tmp_path / "run" / "metrics.csv")
    assert int(metrics[-1]["transitions"]) == learner.transitions >= 300
    assert [row["stage"] for row in metrics] == sorted(row["stage"] for row in metrics)
    assert {row["stage"] for row in metrics} == {"1", "2"}
    saved = rows(tmp_path / "run" / "evaluations.csv")
    assert list(saved[0])[2:] == list(learner.config.evaluation.metrics)
    assert len(saved) == evaluation.count >= 3
    folder = tmp_path / "run" / "trajectories"
    wanted = [folder / row["checkpoint"].replace(".pt", ".parquet") for row in saved]
    assert evaluation.recorded == wanted
    final = read_checkpoint(tmp_path / "run" / "checkpoints" / "final.pt")
    assert (final.scenario, final.transitions) == ("paper", learner.transitions)
    for key, value in learner.algorithm.network.state_dict().items():
        assert torch.equal(final.network.state_dict()[key], value), key
    for part in ("mu.", "value.", "factor_logits."):
        keys = [key for key in before if key.startswith(part)]
        state = learner.algorithm.network.state_dict()
        assert any(not torch.equal(before[key], state[key]) for key in keys), part
    with pytest.raises(ConfigError, match="must be a new or empty folder"):
        make().begin(tmp_path / "run")


@pytest.mark.parametrize("make", [changers, followers])
def test_a_state_from_the_beginning_goes_on_identically(tmp_path, make):
    one = make()
    one.begin(tmp_path / "one")
    shutil.copytree(tmp_path / "one", tmp_path / "other")
    assert one.train(Evaluation())
    other = make(seed=5)
    other.resume(tmp_path / "other")
    assert other.train(Evaluation())
    for learner in (one, other):
        learner.close()
    assert tables(tmp_path / "one") == tables(tmp_path / "other")
    for key, value in one.algorithm.loss.state_dict().items():
        assert torch.equal(other.algorithm.loss.state_dict()[key], value), key


@pytest.mark.parametrize("make", [changers, followers])
def test_with_a_criterion_the_best_model_is_the_final_one(tmp_path, make):
    """The untrained and the last one are among them; a run from its beginning does the same."""
    # None but the first and the last is saved.
    options = ("evaluation.criterion=success_rate", "evaluation.save_interval=10000")
    learner = make(*options)
    learner.begin(tmp_path / "run")
    shutil.copytree(tmp_path / "run", tmp_path / "again")
    before = {key: value.clone() for key, value in learner.algorithm.network.state_dict().items()}
    evaluation = Evaluation()
    assert learner.train(evaluation)
    checkpoints = tmp_path / "run" / "checkpoints"
    saved = {row["checkpoint"]: row for row in rows(tmp_path / "run" / "evaluations.csv")}
    names = [f"step_{count:09d}.pt" for count in (0, learner.transitions)]
    assert [min(saved), max(saved)] == names
    assert len(saved) == evaluation.count == 2
    assert {path.name for path in checkpoints.iterdir()} == {*saved, "final.pt"}
    networks = [read_checkpoint(checkpoints / name).network.state_dict() for name in names]
    for found, wanted in zip(
        networks, (before, learner.algorithm.network.state_dict()), strict=True
    ):
        assert all(torch.equal(found[key], value) for key, value in wanted.items())
    best = max(saved, key=lambda name: float(saved[name]["success_rate"]))
    final = checkpoints / "final.pt"
    assert final.read_bytes() == (checkpoints / best).read_bytes()
    assert read_checkpoint(final).transitions == int(saved[best]["transitions"])

    again = make(*options, seed=5)
    again.resume(tmp_path / "again")
    assert again.train(Evaluation())
    # A finished run that is resumed chooses once more.
    learner.close()
    learner = make(*options, seed=5)
    learner.resume(tmp_path / "run")
    final.unlink()
    assert learner.train(evaluation)
    for one in (learner, again):
        one.close()
    assert tables(tmp_path / "run") == tables(tmp_path / "again")
    for name in ("choice.json", "checkpoints/final.pt"):
        assert (tmp_path / "run" / name).exists()
    choices = [(tmp_path / name / "choice.json").read_bytes() for name in ("run", "again")]
    assert choices[0] == choices[1]
    assert len(saved) == evaluation.count


def test_a_training_need_not_record(tmp_path):
    learner = changers("evaluation.record=false")
    learner.begin(tmp_path / "run")
    evaluation = Evaluation()
    assert learner.train(evaluation)
    learner.close()
    assert evaluation.recorded == [None] * evaluation.count


def test_recording_needs_pyarrow_before_anything_begins(monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(MissingExtraError, match=r"pyarrow: is not installed: .*marl-lanes\[view\]"):
        changers()
    assert changers("evaluation.record=false").transitions == 0


def test_two_runs_of_a_seed_are_the_same(tmp_path):
    runs = {}
    for name, seed in (("one", 3), ("same", 3), ("other", 4)):
        learner = changers(overrides=TWO_ACTIONS, mu="mlp", seed=seed)
        learner.begin(tmp_path / name)
        assert learner.train(Evaluation())
        learner.close()
        runs[name] = tables(tmp_path / name)
    assert runs["one"] == runs["same"]
    assert runs["one"] != runs["other"]


def test_the_others_are_left_alone(tmp_path):
    learner = followers()
    driver = learner.collector.policy[0]
    before = {key: value.clone() for key, value in driver.state_dict().items()}
    learner.begin(tmp_path / "run")
    assert learner.train(Evaluation())
    learner.close()
    assert before
    assert all(torch.equal(before[key], value) for key, value in driver.state_dict().items())
    steps = learner.env.rollout(60, learner.collector.policy, break_when_any_done=False)
    acting = steps["changers", "acting"]
    wanted = driver.policy(steps["changers", "observation"][acting])
    # Without noise.
    assert steps["changers", "action"][acting].allclose(wanted)
    assert acting.any()


def test_many_updates_at_once_are_those_one_by_one(tmp_path, monkeypatch):
    results = []
    for rows_at_once, numbers in ((1, [1] * 7), (48, [7]), (10_000, [5, 0, 2])):
        monkeypatch.setattr("marl_lanes.training.replay.ROWS_AT_ONCE", rows_at_once)
        learner = filled(tmp_path / str(rows_at_once))
        torch.manual_seed(9)
        losses = torch.cat(
            [learner.update(number)["loss"] for number in numbers if number]
        ).tolist()
        results.append((losses, weights_of(learner), torch.rand(3)))
        learner.close()
        assert learner.counters["updates"] == len(losses) == 7
        assert all(loss > 0.0 for loss in losses)
    for losses, weights, random in results[1:]:
        assert losses == results[0][0]
        assert torch.equal(random, results[0][2])
        for key, value in results[0][1].items():
            assert torch.equal(weights[key], value), key


class Crash(Evaluation):
    """Copies the run folder, as it is in the middle of the training, to another place."""

    def __init__(self, run, copy, at):
        super().__init__()
        self.run, self.copy, self.at = run, copy, at

    def __call__(self, network, recorded):
        result = super().__call__(network, recorded)
        if self.count == self.at:
            shutil.copytree(self.run, self.copy)
        return result


def test_a_replay_buffer_of_files_changes_nothing_else(tmp_path):
    """Nor does a crash: what is left of its files, half written, is not used."""
    runs = {}
    for storage in ("memory", "memmap"):
        learner = changers(f"replay.storage={storage}", "replay.capacity=150")
        run = tmp_path / storage
        learner.begin(run)
        assert learner.train(Crash(run, tmp_path / f"{storage}-crashed", at=2))
        assert len(learner.experience) == 150
        assert (run / "replay").exists() == (storage == "memmap")
        learner.close()
        assert not (run / "replay").exists()
        runs[storage] = tables(run)
    assert runs["memory"] == runs["memmap"]
    crashed = tmp_path / "memmap-crashed"
    files = list((crashed / "replay" / "newest").rglob("*.memmap"))
    assert len(files) > 5
    sizes = {path.stem: path.stat().st_size for path in files}
    assert sizes["action"] == 150 * 4
    for path in files:
        path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    other = changers("replay.storage=memmap", "replay.capacity=150", seed=9)
    other.resume(crashed)
    assert 0 < other.transitions < 300
    assert other.train(Evaluation())
    other.close()
    assert tables(crashed) == runs["memmap"]


def test_a_replay_buffer_that_does_not_fit_on_the_disk(tmp_path, monkeypatch):
    # A fifth of the ring of the rare ones comes on top.
    free = 2 * 1200 * 68 - 1
    usage = type("Usage", (), {"free": free})
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage)
    learner = changers("replay.storage=memmap", "replay.capacity=1000", "replay.rare_share=0.2")
    with pytest.raises(ConfigError, match=rf"replay.capacity = 1000: must fit .* {free} are free"):
        learner.begin(tmp_path / "run")
    assert not (tmp_path / "run" / "metrics.csv").exists()
    learner.collector.shutdown()


@pytest.mark.parametrize("make", [changers, followers])
def test_the_memory_of_a_road_and_of_a_transition(tmp_path, make):
    learner = make()
    learner.begin(tmp_path / "run")
    assert learner.train(Evaluation())
    stored = learner.experience.rings["newest"][:]
    assert learner.memory["bytes_per_stored_transition"] == stored.bytes() / len(stored)
    roads = len(learner.env.simulator.snapshot()) / 8
    assert roads < learner.memory["bytes_per_environment"] < 1.2 * roads
    learner.close()
