"""The run folder's tables, and a training state that goes on as if nothing had happened."""

import csv
import json
from pathlib import Path

import pytest
import torch
from tensordict.nn import TensorDictSequential
from torchrl.modules import AdditiveGaussianModule
from torchrl.objectives import SoftUpdate

from marl_lanes import LaneChangeEnv, NAFLoss
from marl_lanes.evaluation.metrics import summarise
from marl_lanes.naf.checkpoint import CheckpointError
from marl_lanes.training.checkpoint import make_network
from marl_lanes.training.collectors import LocalCollector
from marl_lanes.training.config import EVALUATED, ConfigError, ReplayConfig
from marl_lanes.training.replay import Replay
from marl_lanes.training.resume import read_state, restore_state, save_state
from marl_lanes.training.run_folder import FINAL_MODEL, RunFolder, Table
from marl_lanes.training.transitions import LivePolicy, live_transitions

torch.set_num_threads(1)

collector_warnings = pytest.mark.filterwarnings(
    "ignore:Creating .* which inherits from WeightUpdaterBase:DeprecationWarning"
)
COLUMNS = ("transitions", "name", "value")
LEARNED = ("stage", "loss", "sigma")
NEW = {"num_agents": None, "horizon": None, "command": {"probability": 1.0}, "num_slots": 4}
ENDING = {"num_agents": 2, "command": {"probability": 1.0}, "num_slots": 4}


def read(path):
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.reader(file))


def fill(path):
    table = Table(path, COLUMNS)
    table.append((10, "a", 0.5), (20, "b", ""))
    table.append((30, FINAL_MODEL, 1.5))
    table.append()
    table.append((30, "c", 2.5), (200, "d", -1.0))
    table.close()


def test_a_table_begins_anew(tmp_path):
    path = tmp_path / "table.csv"
    fill(path)
    assert read(path)[0] == list(COLUMNS)
    assert [row[1] for row in read(path)[1:]] == ["a", "b", FINAL_MODEL, "c", "d"]
    assert read(path)[2] == ["20", "b", ""]
    Table(path, COLUMNS).close()
    assert read(path) == [list(COLUMNS)]


def test_a_row_is_on_the_disk_at_once(tmp_path):
    table = Table(tmp_path / "table.csv", COLUMNS)
    table.append((1, "a", 2))
    assert read(tmp_path / "table.csv")[1:] == [["1", "a", "2"]]
    table.close()


@pytest.mark.parametrize(
    ("until", "kept"), [(0, []), (9, []), (10, ["a"]), (30, ["a", "b", "c"]), (500, "abcd")]
)
def test_a_resumed_table_is_cut_off_after_the_state(tmp_path, until, kept):
    path = tmp_path / "table.csv"
    fill(path)
    table = Table(path, COLUMNS, until=until)
    assert [row[1] for row in read(path)[1:]] == list(kept)
    table.append((501, "new", 0))
    table.close()
    assert [row[1] for row in read(path)] == ["name", *kept, "new"]
    assert [entry.name for entry in tmp_path.iterdir()] == ["table.csv"]


def test_success_leads_what_is_told_of_a_saved_model():
    assert EVALUATED[:2] == ("success_rate", "completion_rate")
    assert set(EVALUATED) < set(summarise([]))


def test_a_new_run_makes_its_folder(tmp_path):
    path = tmp_path / "deep" / "run"
    run = RunFolder(path, LEARNED)
    run.log("train", {"loss": 1.0, "text": "left out", "none": None}, 5)
    run.close()
    names = {entry.name for entry in path.iterdir()}
    assert names == {
        "checkpoints",
        "metrics.csv",
        "maneuvers.csv",
        "evaluations.csv",
        "tensorboard",
    }
    assert any((path / "tensorboard").glob("events.*"))
    assert read(path / "maneuvers.csv") == [["transitions", "return", "outcome"]]
    assert run.config == path / "config.yaml"
    assert run.state == path / "resume.pt"
    assert run.figures == path / "figures"


@pytest.mark.parametrize(
    ("values", "chosen"),
    [
        ([-3.0, -1.0, -2.0], "b.pt"),
        ([-1.0, -2.0, -1.0], "a.pt"),
        (["", -10.0, 0.0], "c.pt"),
        (["", "", ""], "a.pt"),
    ],
)
def test_the_best_saved_model_becomes_the_final_one(tmp_path, values, chosen):
    """Of equals the earliest; one without a value is the worst."""
    run = RunFolder(tmp_path / "run", LEARNED, evaluated=("other", "quality"))
    for transitions, (name, value) in enumerate(zip("abc", values, strict=True)):
        (run.checkpoints / f"{name}.pt").write_text(name, encoding="utf-8")
        run.evaluations.append((transitions, f"{name}.pt", 7.0, value))
    run.choose_model("quality")
    run.close()
    assert (run.checkpoints / "final.pt").read_text(encoding="utf-8") == chosen[0]
    choice = json.loads((run.path / "choice.json").read_text(encoding="utf-8"))
    found = [None if value == "" else value for value in values]
    assert choice == {
        "quality": dict(zip(("a.pt", "b.pt", "c.pt"), found, strict=True)),
        "chosen": chosen,
    }


def test_a_folder_with_a_run_is_refused(tmp_path):
    run = RunFolder(tmp_path, LEARNED)
    run.metrics.append((1, 2, 3, 4, 5, 6, 7))
    run.close()
    run.config.write_text("seed: 0\n", encoding="utf-8")
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    with pytest.raises(ConfigError, match=r"output = .*must be a new or empty folder.*resume="):
        RunFolder(tmp_path, LEARNED)
    after = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    assert after == before
    RunFolder(tmp_path, LEARNED, until=1).close()
    assert len(read(tmp_path / "metrics.csv")) == 2


class Parts:
    """The parts of a small training, as the program puts them together."""

    def __init__(self, overrides, *, capacity=300, seed=0):
        torch.manual_seed(seed)
        self.env = LaneChangeEnv("paper", 3, overrides=overrides, seed=seed)
        self.network = make_network(self.env.scenario, "damped", [8])
        self.loss = NAFLoss(self.network)
        self.loss.make_value_estimator(gamma=0.9)
        self.updater = SoftUpdate(self.loss, tau=0.1)
        self.optimizer = torch.optim.Adam(self.network.parameters(), lr=1e-3)
        settings = ReplayConfig(
            capacity=capacity,
            storage="memory",
            batch_size=16,
            rare_share=0.25,
            warmup_transitions=0,
        )
        self.replay = Replay(settings, Path("unused"), 0.0)
        noise = AdditiveGaussianModule(
            self.env.full_action_spec,
            action_key=self.env.action_keys[0],
            sigma_init=0.05,
            sigma_end=0.05,
        )
        policy = TensorDictSequential(LivePolicy(self.network.policy().module, 1), noise)
        self.collector = LocalCollector(self.env, policy, 100)
        self.losses = []
        self.ends = 0

    def train(self, rounds):
        for _ in range(rounds):
            batch = self.collector.next()
            self.ends += int(batch["next", "done"].sum())
            self.replay.extend(live_transitions(batch))
            for _ in range(5):
                self.optimizer.zero_grad()
                value = self.loss(self.replay.sample(1)[0])["loss"]
                value.backward()
                self.optimizer.step()
                self.updater.step()
                self.losses.append(value.item())

    def kept(self):
        return {
            "loss": self.loss,
            "optimizer": self.optimizer,
            "replay": self.replay,
            "collector": self.collector,
        }


@pytest.mark.training
@collector_warnings
@pytest.mark.parametrize("overrides", [NEW, ENDING], ids=["endless", "episodes"])
@pytest.mark.parametrize("capacity", [300, 100_000], ids=["ring", "part"])
def test_a_restored_training_goes_on_identically(tmp_path, overrides, capacity):
    file = tmp_path / "resume.pt"
    one = Parts(overrides, capacity=capacity)
    one.train(6)
    save_state(file, counters={"transitions": 12.0}, **one.kept())
    num_before = one.ends
    one.train(6)
    other = Parts(overrides, capacity=capacity, seed=99)
    content = read_state(file)
    assert content["counters"] == {"transitions": 12.0}
    restore_state(content, **other.kept())
    other.train(6)
    assert other.losses == one.losses[30:]
    assert len(set(one.losses)) > 50
    for key, value in one.loss.state_dict().items():
        assert torch.equal(other.loss.state_dict()[key], value), key
    assert other.env.simulator.snapshot() == one.env.simulator.snapshot()
    assert (len(one.replay) == 300) == (capacity == 300)
    for name, ring in one.replay.rings.items():
        assert len(ring) == len(other.replay.rings[name]), name
        assert not len(ring) or (ring[:] == other.replay.rings[name][:]).all(), name
    assert other.ends == one.ends - num_before
    assert (other.ends > 0) == (overrides is ENDING)
    for parts in (one, other):
        parts.collector.shutdown()


@pytest.mark.training
@collector_warnings
def test_a_state_before_the_first_transition(tmp_path):
    one = Parts(NEW)
    save_state(tmp_path / "s.pt", counters={}, **one.kept())
    one.train(3)
    other = Parts(NEW, seed=5)
    content = read_state(tmp_path / "s.pt")
    assert [ring["rows"] for ring in content["replay"].values()] == [{}, {}]
    restore_state(content, **other.kept())
    # The roads of both begin with a reset: the snapshot was taken before the first.
    assert len(other.replay) == 0
    for key, value in one.loss.state_dict().items():
        assert other.loss.state_dict()[key].shape == value.shape, key
    one.collector.shutdown()


def test_a_missing_state_is_named(tmp_path):
    with pytest.raises(CheckpointError, match=r"resume\.pt"):
        read_state(tmp_path / "resume.pt")
