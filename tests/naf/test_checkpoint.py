"""Reading checkpoints: without running code, and what is refused."""

import contextlib
import os
import warnings
import zipfile
from pathlib import Path

import numpy as np
import pytest
import torch
from checkpoints import OTHER_FILES, assert_runs_no_code, save_trained
from damage import assert_read_as_it_was_or_refused
from systems import needs

from marl_lanes.naf.checkpoint import (
    CheckpointError,
    find_checkpoint,
    greedy_policy,
    read_checkpoint,
    read_content,
)
from marl_lanes.naf.network import NAFNetwork

torch.set_num_threads(1)


def test_greedy_actions_of_no_agents(policy_file):
    act = greedy_policy(read_checkpoint(policy_file).network)
    assert act(np.zeros((0, 6), np.float32)).shape == (0, 1)


def test_it_holds_only_plain_types_and_tensors(policy_file):
    content = torch.load(policy_file, weights_only=True)
    assert {"config", "weights", "scenario", "transitions"} < set(content)
    assert all(isinstance(value, torch.Tensor) for value in content["weights"].values())
    network = NAFNetwork(**content["config"])
    network.load_state_dict(content["weights"])


def test_a_policy_of_the_zoo_has_its_file(small_zoo):
    assert find_checkpoint(Path("zoo:paper")) == small_zoo / "paper.pt"
    assert plain(Path("zoo:paper")) == plain(small_zoo / "paper.pt")
    assert find_checkpoint(small_zoo / "zoo:x.pt") == small_zoo / "zoo:x.pt"


def test_what_the_zoo_does_not_have_is_refused(small_zoo):
    with pytest.raises(CheckpointError, match=r"^checkpoint zoo:best: no such policy.*zoo:paper"):
        read_content(Path("zoo:best"))
    truncate(small_zoo / "paper.pt", 0.5)
    with pytest.raises(CheckpointError, match=r"^checkpoint zoo:paper: its file paper\.pt is not"):
        read_content(Path("zoo:paper"))
    (small_zoo / "paper.pt").unlink()
    with pytest.raises(CheckpointError, match=r"^checkpoint zoo:paper: .*No such file"):
        read_content(Path("zoo:paper"))


@pytest.mark.parametrize("save", ["pickle", "torch"])
def test_code_in_a_file_is_not_run(tmp_path, save):
    assert_runs_no_code(read_checkpoint, tmp_path, save)


def truncate(file, share):
    data = file.read_bytes()
    file.write_bytes(data[: int(len(data) * share)])


@pytest.mark.parametrize("share", [0.0, 0.001, 0.3, 0.9, 0.999])
def test_a_truncated_file_is_refused(policy_file, share):
    truncate(policy_file, share)
    with pytest.raises(CheckpointError, match=r"policy\.pt") as caught:
        read_checkpoint(policy_file)
    assert len(str(caught.value).splitlines()) == 1


def plain(path):
    """The content of a checkpoint, comparable."""
    content = read_content(path)
    weights = {key: value.numpy().tobytes() for key, value in content["weights"].items()}
    return content | {"weights": weights}


def test_a_damaged_file_is_refused_or_reads_the_same(policy_file):
    found = assert_read_as_it_was_or_refused(policy_file, plain, CheckpointError)
    assert found > 100


def test_every_byte_of_the_directory_counts(policy_file):
    """The attributes of an entry, too: of a folder torch reads what is in memory by chance."""
    content, wanted = policy_file.read_bytes(), plain(policy_file)
    for place in range(content.index(b"PK\x01\x02"), len(content)):
        changed = bytearray(content)
        changed[place] ^= 0x10
        policy_file.write_bytes(changed)
        with contextlib.suppress(CheckpointError):
            assert plain(policy_file) == wanted, place


def test_a_user_can_read_it_with_torch_alone(policy_file):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert torch.load(policy_file, weights_only=True).keys() == read_content(policy_file).keys()


def test_equal_networks_are_equal_files(tmp_path):
    one, other = save_trained(tmp_path / "one.pt"), save_trained(tmp_path / "deep" / "other.pt")
    assert one.read_bytes() == other.read_bytes()


def rewritten(path, change, **options):
    """Write the archive anew, its entries as ``change`` gives them: pairs of name and bytes."""
    with zipfile.ZipFile(path) as archive:
        entries = [(entry.filename, archive.read(entry)) for entry in archive.infolist()]
    with zipfile.ZipFile(path, "w", **options) as archive, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for name, content in change(entries):
            archive.writestr(zipfile.ZipInfo(name) if not options else name, content)


def test_a_compressed_file_is_refused(policy_file):
    """A zip bomb would fill the memory."""
    rewritten(policy_file, lambda entries: entries, compression=zipfile.ZIP_DEFLATED)
    with pytest.raises(CheckpointError, match="must be files that are not compressed"):
        read_checkpoint(policy_file)


@pytest.mark.parametrize(
    "change",
    [
        lambda entries: [*entries, entries[4]],
        lambda entries: entries[:0],
        lambda entries: entries[1:],
        lambda entries: [(f"/{name}", content) for name, content in entries],
        lambda entries: [(f"../../{name}", content) for name, content in entries],
        lambda entries: [(name.replace("archive", "\n"), content) for name, content in entries[1:]],
        lambda entries: [*entries, ("archive/constants.pkl", b""), ("archive/code/x.py", b"1/0")],
        lambda entries: [(name, content * 2) for name, content in entries],
        lambda entries: [(name, content[:-1]) for name, content in entries],
    ],
    ids=["twice", "nothing", "headless", "root", "above", "newline", "script", "long", "short"],
)
def test_strange_entries_are_refused_or_change_nothing(policy_file, change):
    wanted = plain(policy_file)
    before = set(policy_file.parent.parent.rglob("*"))
    rewritten(policy_file, change)
    with contextlib.suppress(CheckpointError):
        assert plain(policy_file) == wanted
    assert set(policy_file.parent.parent.rglob("*")) == before


@needs("mkfifo")
def test_what_is_no_file_is_refused(tmp_path):
    os.mkfifo(tmp_path / "pipe.pt")
    for path in (tmp_path / "pipe.pt", Path("/dev/zero"), tmp_path):
        with pytest.raises(CheckpointError, match="cannot be read: must be a regular file"):
            read_checkpoint(path)


def nested(depth):
    """A list that is short in a file and long as a text."""
    value = ["x"]
    for _ in range(depth):
        value = [value] * 10
    return value


def test_absurd_contents_are_refused_in_a_line_and_at_once(policy_file):
    content = torch.load(policy_file, weights_only=True)
    weights = content["weights"]
    first = next(key for key, value in weights.items() if value.ndim == 2)
    rows, columns = weights[first].shape
    huge = torch.zeros(1).expand(10**6, 10**6)

    def bad(**changes):
        return content | {"config": content["config"] | changes}

    def weighing(value):
        return content | {"weights": weights | {first: value}}

    cases = [
        (bad(hidden_sizes=[10**9, 10**9]), "hidden_sizes = .1000000000, 1000000000.: must be that"),
        (bad(hidden_sizes=[0] * 10**5), "hidden_sizes = .0, 0, 0"),
        (bad(hidden_sizes="wide"), "inconsistent"),
        (bad(hidden_sizes=None), "inconsistent"),
        (bad(features=nested(12)), "config.features: must be a plain value"),
        (bad(mu=nested(12)), "config.mu: must be a plain value"),
        (bad(mu="x" * 10**6), "inconsistent"),
        (bad(action_low=[float("nan")]), "inconsistent"),
        (content | {"scenario": nested(12)}, "scenario and transitions"),
        (content | {"transitions": 1e400}, "scenario and transitions"),
        (weighing(weights[first] * float("nan")), "every number must be finite"),
        (weighing(weights[first] + float("inf")), "every number must be finite"),
        (weighing(weights[first].double()), "torch.float64 of shape"),
        (weighing(weights[first].to(torch.complex64)), "torch.complex64 of shape"),
        (weighing(weights[first][:1]), f"of shape .1, {columns}.: must be"),
        (weighing(torch.zeros(columns, rows).T), "in another order: must be"),
        (weighing(torch.zeros(1).expand(rows, columns)), "in another order: must be"),
        (weighing(huge), "of shape .1000000, 1000000. in another order"),
        (weighing(weights[first].to_sparse()), "no dense tensor|inconsistent"),
        (weighing(weights[first].to("meta")), "inconsistent|must be"),
        (weighing("text"), "inconsistent"),
        (content | {"weights": weights | {"more": weights[first]}}, "weights: .'more'.: must be"),
        (content | {"weights": {3: weights[first]}}, "inconsistent"),
    ]
    for case, message in cases:
        torch.save(case, policy_file)
        with pytest.raises(CheckpointError, match=rf"policy\.pt: .*({message})") as caught:
            read_checkpoint(policy_file)
        assert "\n" not in str(caught.value)
        assert len(str(caught.value)) < 500


@pytest.mark.parametrize("data", OTHER_FILES)
def test_other_files_are_refused(tmp_path, data):
    file = tmp_path / "other.pt"
    file.write_bytes(data)
    with pytest.raises(CheckpointError, match=r"other\.pt"):
        read_checkpoint(file)


def test_a_missing_file_and_a_folder_are_refused(tmp_path):
    with pytest.raises(CheckpointError, match=r"absent\.pt"):
        read_checkpoint(tmp_path / "absent.pt")
    with pytest.raises(CheckpointError, match=tmp_path.name):
        read_checkpoint(tmp_path)


@pytest.mark.parametrize(
    "content",
    [
        [1, 2],
        torch.zeros(3),
        {},
        {"format": "another"},
        {"format": 3},
        {"format": "marl-lanes NAF policy 3"},
        {"format": "marl-lanes training state 5"},
    ],
)
def test_other_forms_are_refused(tmp_path, content):
    file = tmp_path / "form.pt"
    torch.save(content, file)
    with pytest.raises(CheckpointError, match=r"form\.pt.*marl-lanes NAF policy 4"):
        read_checkpoint(file)


@pytest.mark.parametrize("key", ["config", "weights", "scenario", "transitions"])
def test_what_lacks_a_part_is_refused(policy_file, key):
    content = torch.load(policy_file, weights_only=True)
    del content[key]
    torch.save(content, policy_file)
    with pytest.raises(CheckpointError, match=rf"policy\.pt.*{key}"):
        read_checkpoint(policy_file)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("config", 3),
        ("config", {"features": ["speed"]}),
        ("config", {"mu": "wild"}),
        ("weights", 3),
        ("weights", {}),
        ("weights", []),
        ("transitions", "many"),
        ("transitions", None),
    ],
)
def test_inconsistent_parts_are_refused(policy_file, key, value):
    content = torch.load(policy_file, weights_only=True)
    if isinstance(value, dict) and value and key == "config":
        value = content["config"] | value
    content[key] = value
    torch.save(content, policy_file)
    with pytest.raises(CheckpointError, match=r"policy\.pt"):
        read_checkpoint(policy_file)


def test_checkpoint_errors_are_value_errors():
    assert issubclass(CheckpointError, ValueError)
