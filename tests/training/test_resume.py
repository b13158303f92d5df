"""A training state goes on exactly as before, and is read without running code."""

import gc
import zipfile
from pathlib import Path

import pytest
import torch
from checkpoints import OTHER_FILES, assert_runs_no_code
from damage import assert_read_as_it_was_or_refused
from tensordict.nn import TensorDictSequential
from torchrl.modules import AdditiveGaussianModule
from torchrl.objectives import SoftUpdate

from marl_lanes import LaneChangeEnv, NAFLoss
from marl_lanes.naf.checkpoint import CheckpointError
from marl_lanes.training.checkpoint import make_network
from marl_lanes.training.collectors import LocalCollector
from marl_lanes.training.config import ReplayConfig
from marl_lanes.training.replay import Replay
from marl_lanes.training.resume import read_state, restore_state, save_state
from marl_lanes.training.transitions import LivePolicy, live_transitions

torch.set_num_threads(1)

collector_warnings = pytest.mark.filterwarnings(
    "ignore:Creating .* which inherits from WeightUpdaterBase:DeprecationWarning"
)

NEW = {"num_agents": None, "horizon": None, "command": {"probability": 1.0}, "num_slots": 4}
ENDING = {"num_agents": 2, "command": {"probability": 1.0}, "num_slots": 4}


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
        self.replay = Replay(settings, Path("unused"), 0.0, transitions_per_update=1.0)
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
            "experience": self.replay,
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
    tables = {"metrics": {"size": 5, "sha256": "ab"}}
    save_state(file, counters={"transitions": 12.0}, tables=tables, **one.kept())
    num_before = one.ends
    one.train(6)
    other = Parts(overrides, capacity=capacity, seed=99)
    content = read_state(file)
    assert content["counters"] == {"transitions": 12.0}
    assert content["tables"] == tables
    restore_state(file, content, **other.kept())
    # Nothing of the file is in use any more.
    del content
    gc.collect()
    assert str(file) not in Path("/proc/self/maps").read_text(encoding="utf-8")
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
def test_a_state_of_more_gpus_is_taken_as_far_as_there_are_some(tmp_path, monkeypatch):
    one = Parts(NEW)
    save_state(tmp_path / "s.pt", counters={}, tables={}, **one.kept())
    content = read_state(tmp_path / "s.pt") | {"random_cuda": ["first", "second", "third"]}
    taken = []
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 2)
    monkeypatch.setattr(torch.cuda, "set_rng_state", lambda *given: taken.append(given))
    restore_state(tmp_path / "s.pt", content, **one.kept())
    assert taken == [("first", 0), ("second", 1)]
    one.collector.shutdown()


@pytest.mark.training
@collector_warnings
def test_a_state_before_the_first_transition(tmp_path):
    one = Parts(NEW)
    save_state(tmp_path / "s.pt", counters={}, tables={}, **one.kept())
    one.train(3)
    other = Parts(NEW, seed=5)
    content = read_state(tmp_path / "s.pt")
    assert [ring["rows"] for ring in content["replay"].values()] == [{}, {}]
    restore_state(tmp_path / "s.pt", content, **other.kept())
    # The roads of both begin with a reset: the snapshot was taken before the first.
    assert len(other.replay) == 0
    for key, value in one.loss.state_dict().items():
        assert other.loss.state_dict()[key].shape == value.shape, key
    one.collector.shutdown()


@pytest.mark.training
@collector_warnings
def test_a_damaged_state_is_refused_or_reads_the_same(tmp_path):
    one = Parts(NEW)
    one.train(1)
    save_state(tmp_path / "s.pt", counters={"a": 1.0}, tables={}, **one.kept())
    one.collector.shutdown()

    def plain(path):
        torch.save(read_state(path), tmp_path / "again.pt")
        with zipfile.ZipFile(tmp_path / "again.pt") as archive:
            return [entry.CRC for entry in archive.infolist()]

    found = assert_read_as_it_was_or_refused(tmp_path / "s.pt", plain, CheckpointError, 100)
    assert found > 50


@pytest.mark.parametrize("save", ["pickle", "torch"])
def test_code_in_a_file_is_not_run(tmp_path, save):
    assert_runs_no_code(read_state, tmp_path, save)


@pytest.mark.parametrize("data", OTHER_FILES)
def test_other_files_are_refused(tmp_path, data):
    file = tmp_path / "other.pt"
    file.write_bytes(data)
    with pytest.raises(CheckpointError, match=r"other\.pt"):
        read_state(file)


def test_a_missing_file_and_a_folder_are_refused(tmp_path):
    with pytest.raises(CheckpointError, match=r"absent\.pt"):
        read_state(tmp_path / "absent.pt")
    with pytest.raises(CheckpointError, match=tmp_path.name):
        read_state(tmp_path)


def test_a_checkpoint_is_not_a_training_state(policy_file):
    with pytest.raises(CheckpointError, match=r"policy\.pt.*marl-lanes training state 6"):
        read_state(policy_file)


@pytest.mark.training
@collector_warnings
@pytest.mark.parametrize(
    ("part", "change", "message"),
    [
        ("loss", lambda value: dict(list(value.items())[1:]), "weights: "),
        (
            "loss",
            lambda value: {
                key: one.double() if "weight" in key else one for key, one in value.items()
            },
            "torch.float64",
        ),
        ("loss", 3, ""),
        ("optimizer", {"state": {}}, ""),
        ("replay", {}, "newest"),
        ("workers", [], "training state of 0 workers"),
        ("workers", [{"roads": torch.zeros(9, dtype=torch.uint8)}], ""),
        ("random", torch.zeros(3), ""),
    ],
)
def test_a_state_of_another_run_is_refused_in_a_line(tmp_path, part, change, message):
    one = Parts(NEW)
    save_state(tmp_path / "s.pt", counters={}, tables={}, **one.kept())
    content = read_state(tmp_path / "s.pt")
    content[part] = change(content[part]) if callable(change) else change
    with pytest.raises(
        CheckpointError, match=rf"s\.pt: does not fit this run: .*{message}"
    ) as caught:
        restore_state(tmp_path / "s.pt", content, **one.kept())
    assert "\n" not in str(caught.value)
    one.collector.shutdown()
