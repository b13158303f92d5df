"""Reading checkpoints: without running code, and what is refused."""

import numpy as np
import pytest
import torch
from checkpoints import OTHER_FILES, assert_runs_no_code

from marl_lanes.naf.checkpoint import CheckpointError, greedy_policy, read_checkpoint
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
