"""What the updates are drawn from: the newest transitions, and the rare ones once more."""

import sys

import pytest
import torch
from tensordict import TensorDict

from marl_lanes.training.config import ReplayConfig
from marl_lanes.training.replay import Replay


def transitions(start, number, rare=()):
    """Rows whose value is their number; those of ``rare`` are rare."""
    values = torch.arange(start, start + number)
    is_aborting = torch.isin(values, torch.tensor(rare, dtype=torch.int64))
    return TensorDict({"value": values, "is_aborting": is_aborting}, [number])


def make(folder, *, capacity=40, share=0.25, storage="memory"):
    config = ReplayConfig(
        capacity=capacity,
        storage=storage,
        batch_size=8,
        rare_share=share,
        warmup_transitions=0,
    )
    return Replay(config, folder / "replay", 9.0, transitions_per_update=4.0)


def wraps(extend, sizes):
    def noted(rows):
        sizes.append(len(rows))
        return extend(rows)

    return noted


@pytest.mark.parametrize("storage", ["memory", "memmap"])
def test_each_batch_has_its_share_of_rare_transitions(tmp_path, storage):
    replay = make(tmp_path, storage=storage)
    replay.extend(transitions(0, 30, rare=(3, 7, 11)))
    batches = replay.sample(50)
    assert batches.shape == (50, 8)
    # Two of eight from three rare ones; the others from all.
    assert batches["is_aborting"][:, 6:].all()
    assert set(batches["value"][:, 6:].flatten().tolist()) == {3, 7, 11}
    assert len(set(batches["value"][:, :6].flatten().tolist())) == 30
    assert (batches["is_aborting"].sum(1) >= 2).all()


def test_rare_transitions_outlive_the_newest(tmp_path):
    replay = make(tmp_path)
    replay.extend(transitions(0, 20, rare=range(8)))
    for start in (100, 200, 300):
        replay.extend(transitions(start, 20))
    assert len(replay) == 40
    batches = replay.sample(100)
    assert batches["value"][:, :6].min() >= 200
    assert set(batches["value"][:, 6:].flatten().tolist()) == set(range(8))
    # The ring holds a quarter of 40; the oldest go first.
    replay.extend(transitions(400, 4, rare=range(400, 404)))
    kept = {*range(2, 8), *range(400, 404)}
    assert set(replay.sample(200)["value"][:, 6:].flatten().tolist()) == kept


@pytest.mark.parametrize("storage", ["memory", "memmap"])
def test_of_more_rows_than_fit_the_newest_are_kept(tmp_path, storage, monkeypatch):
    """A GPU writes in no order: no two rows may be for one place."""
    replay = make(tmp_path, storage=storage)
    sizes = []
    for ring in replay.rings.values():
        monkeypatch.setattr(ring, "extend", wraps(ring.extend, sizes))
    replay.extend(transitions(0, 95, rare=range(30)))
    assert sizes == [40, 10]
    batches = replay.sample(200)
    assert set(batches["value"][:, :6].flatten().tolist()) == set(range(55, 95))
    assert set(batches["value"][:, 6:].flatten().tolist()) == set(range(20, 30))


@pytest.mark.parametrize(("share", "rare"), [(0.25, (5,)), (0.25, ()), (0.0, (1, 2, 3, 4))])
def test_without_enough_of_them_all_are_drawn_alike(tmp_path, share, rare):
    replay = make(tmp_path, share=share)
    replay.extend(transitions(0, 20, rare))
    values = replay.sample(100)["value"]
    assert values.shape == (100, 8)
    assert len(set(values[:, 6:].flatten().tolist())) == 20
    torch.manual_seed(1)
    drawn = replay.sample(3)["value"]
    torch.manual_seed(1)
    assert torch.equal(replay.rings["newest"].sample(24)["value"].reshape(3, 8), drawn)


def test_rows_that_say_nothing_of_it_are_not_rare(tmp_path):
    replay = make(tmp_path)
    replay.extend(transitions(0, 20, rare=range(20)).exclude("is_aborting"))
    assert (len(replay), len(replay.rings["rare"])) == (20, 0)
    replay.extend(transitions(0, 0))
    assert replay.sample(2).shape == (2, 8)


def test_a_restored_replay_goes_on_identically(tmp_path):
    one, other = make(tmp_path / "one"), make(tmp_path / "other")
    one.extend(transitions(0, 55, rare=range(0, 55, 3)))
    other.restore(one.state())
    draws = []
    for replay in (one, other):
        replay.extend(transitions(60, 7, rare=(61, 62)))
        torch.manual_seed(3)
        draws.append(replay.sample(20))
    assert (draws[0] == draws[1]).all()
    assert one.state()["rare"]["writer"] == other.state()["rare"]["writer"]


@pytest.mark.skipif(sys.platform == "win32", reason="files have no holes there")
@pytest.mark.parametrize("system", [sys.platform, "darwin"])
def test_its_files_have_their_place_on_the_disk(tmp_path, monkeypatch, system):
    """Written into a hole of a file, a full disk would end the process without a word."""
    monkeypatch.setattr(sys, "platform", system)
    replay = make(tmp_path, capacity=100_000, storage="memmap")
    replay.extend(transitions(0, 20, rare=(3,)))
    assert replay.rings["newest"][:20]["value"].tolist() == list(range(20))
    files = [path.stat() for path in (tmp_path / "replay").rglob("*.memmap")]
    assert len(files) >= 4
    assert min(file.st_size for file in files) >= 25_000
    assert all(512 * file.st_blocks >= file.st_size for file in files)
