"""Checkpoints: whole, without code, and refused where they do not fit."""

import pickle
from pathlib import Path

import numpy as np
import pytest
import torch

from marl_lanes import load_scenario
from marl_lanes.envs.followers import load_follower
from marl_lanes.naf.checkpoint import FORMAT, CheckpointError, greedy_policy, read_checkpoint
from marl_lanes.naf.network import NAFNetwork
from marl_lanes.traffic.roles.follower import FOLLOWER
from marl_lanes.training.checkpoint import (
    load_checkpoint,
    make_network,
    save_checkpoint,
)
from marl_lanes.training.resume import read_state

torch.set_num_threads(1)
PAPER = load_scenario("paper")
LONGITUDINAL = load_scenario(
    "paper",
    {
        "action": {"longitudinal": {"max_acceleration": 1.5, "max_braking": 2.5}},
        "observation": {
            "features": [*PAPER.observation.features, "car_following_acceleration"],
        },
    },
)


class Attack:
    """A pickle that makes a file when it is read carelessly."""

    def __init__(self, target):
        self.target = target

    def __reduce__(self):
        return Path.touch, (self.target,)


def trained(mu="paper", scenario=PAPER):
    """A network whose weights are not the initial ones."""
    torch.manual_seed(3)
    network = make_network(scenario, mu, [8, 4])
    with torch.no_grad():
        for parameter in network.parameters():
            parameter.add_(0.1 * torch.randn_like(parameter))
    return network


@pytest.fixture
def path(tmp_path):
    file = tmp_path / "policy.pt"
    save_checkpoint(file, trained(), "paper", 1234)
    return file


def states(count=50):
    generator = np.random.default_rng(0)
    high = [30.0, 2.0, 3.75, 0.05, 0.05, 0.002]
    return (generator.uniform(-1.0, 1.0, (count, 6)) * high + [20, 0, 0, 0, 0, 0]).astype("f4")


@pytest.mark.parametrize("mu", ["cascade", "paper", "damped", "mlp"])
def test_a_saved_policy_acts_as_before(tmp_path, mu):
    file = tmp_path / "deep" / "folder" / "policy.pt"
    network = trained(mu)
    save_checkpoint(file, network, "paper", 77)
    found = load_checkpoint(file, PAPER)
    assert (found.scenario, found.transitions) == ("paper", 77)
    assert found.network.config == network.config
    assert found.network.hidden_sizes == [8, 4]
    for key, value in network.state_dict().items():
        assert torch.equal(found.network.state_dict()[key], value), key
    expected = greedy_policy(network)(states())
    assert np.array_equal(greedy_policy(found.network)(states()), expected)
    assert expected.shape == (50, 1)
    assert expected.dtype == np.float64
    assert np.abs(expected).max() <= 0.5
    assert len(np.unique(expected)) > 10
    other = greedy_policy(make_network(PAPER, mu, [8, 4]))(states())
    assert not np.array_equal(other, expected)
    assert [entry.name for entry in file.parent.iterdir()] == ["policy.pt"]


def test_greedy_actions_of_no_agents(path):
    act = greedy_policy(read_checkpoint(path).network)
    assert act(np.zeros((0, 6), np.float32)).shape == (0, 1)


def test_it_holds_only_plain_types_and_tensors(path):
    content = torch.load(path, weights_only=True)
    assert {"config", "weights", "scenario", "transitions"} < set(content)
    assert all(isinstance(value, torch.Tensor) for value in content["weights"].values())
    network = NAFNetwork(**content["config"])
    network.load_state_dict(content["weights"])


@pytest.mark.parametrize("read", [read_checkpoint, read_state])
@pytest.mark.parametrize("save", ["pickle", "torch"])
def test_code_in_a_file_is_not_run(tmp_path, read, save):
    target, file = tmp_path / "made", tmp_path / "evil.pt"
    content = {"format": FORMAT, "config": Attack(target)}
    if save == "pickle":
        file.write_bytes(pickle.dumps(content, protocol=2))
    else:
        torch.save(content, file)
    with pytest.raises(CheckpointError, match=r"evil\.pt"):
        read(file)
    assert not target.exists()
    # Read with trust, it would have been made.
    if save == "pickle":
        pickle.loads(file.read_bytes())  # noqa: S301
    else:
        torch.load(file, weights_only=False)
    assert target.exists()


def truncate(file, share):
    data = file.read_bytes()
    file.write_bytes(data[: int(len(data) * share)])


@pytest.mark.parametrize("share", [0.0, 0.001, 0.3, 0.9, 0.999])
def test_a_truncated_file_is_refused(path, share):
    truncate(path, share)
    with pytest.raises(CheckpointError, match=r"policy\.pt") as caught:
        read_checkpoint(path)
    assert len(str(caught.value).splitlines()) == 1


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"hello\n",
        b"\x80\x02",
        b"PK\x03\x04 not a zip",
        bytes(range(256)),
        b"\x89PNG\r\n\x1a\n" * 20,
        pickle.dumps([1, 2, 3], protocol=2),
    ],
)
def test_other_files_are_refused(tmp_path, data):
    file = tmp_path / "other.pt"
    file.write_bytes(data)
    for read in (read_checkpoint, read_state):
        with pytest.raises(CheckpointError, match=r"other\.pt"):
            read(file)


def test_a_missing_file_and_a_folder_are_refused(tmp_path):
    for read in (read_checkpoint, read_state):
        with pytest.raises(CheckpointError, match=r"absent\.pt"):
            read(tmp_path / "absent.pt")
        with pytest.raises(CheckpointError, match=tmp_path.name):
            read(tmp_path)


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


def test_a_checkpoint_is_not_a_training_state(path):
    with pytest.raises(CheckpointError, match=r"policy\.pt.*marl-lanes training state 5"):
        read_state(path)


@pytest.mark.parametrize("key", ["config", "weights", "scenario", "transitions"])
def test_what_lacks_a_part_is_refused(path, key):
    content = torch.load(path, weights_only=True)
    del content[key]
    torch.save(content, path)
    with pytest.raises(CheckpointError, match=rf"policy\.pt.*{key}"):
        read_checkpoint(path)


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
def test_inconsistent_parts_are_refused(path, key, value):
    content = torch.load(path, weights_only=True)
    if isinstance(value, dict) and value and key == "config":
        value = content["config"] | value
    content[key] = value
    torch.save(content, path)
    with pytest.raises(CheckpointError, match=r"policy\.pt"):
        read_checkpoint(path)


@pytest.mark.parametrize(
    "features",
    [
        ["speed", "lateral_deviation", "yaw", "yaw_rate", "curvature"],
        ["acceleration", "speed", "lateral_deviation", "yaw", "yaw_rate", "curvature"],
        [*PAPER.observation.features, "time"],
    ],
)
def test_other_features_are_refused(path, features):
    other = load_scenario("paper", {"observation": {"features": features}})
    with pytest.raises(CheckpointError, match=r"policy\.pt.*features") as caught:
        load_checkpoint(path, other)
    assert str(features) in str(caught.value)
    assert str(list(PAPER.observation.features)) in str(caught.value)


@pytest.mark.parametrize("bound", [0.4, 0.6])
def test_another_bound_is_refused(path, bound):
    other = load_scenario("paper", {"action": {"max_yaw_acceleration": bound}})
    with pytest.raises(CheckpointError, match=rf"policy\.pt.*0\.5.*{bound}"):
        load_checkpoint(path, other)


def test_any_bound_that_fits_is_taken(tmp_path):
    # 0.3 is not a float32 number.
    other = load_scenario("paper", {"action": {"max_yaw_acceleration": 0.3}})
    save_checkpoint(tmp_path / "p.pt", make_network(other, "paper"), "other", 0)
    assert load_checkpoint(tmp_path / "p.pt", other).scenario == "other"


def test_two_actions_have_the_scenarios_bounds(tmp_path):
    network = make_network(LONGITUDINAL, "damped+idm", [8])
    assert network.config["action_low"] == [-0.5, -2.5]
    assert network.config["action_high"] == [0.5, 1.5]
    assert network.features == list(LONGITUDINAL.observation.features)
    save_checkpoint(tmp_path / "p.pt", network, "two", 5)
    found = load_checkpoint(tmp_path / "p.pt", LONGITUDINAL)
    observations = np.zeros((3, 7), np.float32)
    assert greedy_policy(found.network)(observations).shape == (3, 2)


@pytest.mark.parametrize("bounds", [{"max_braking": 2.0}, {"max_acceleration": 2.0}, None])
def test_another_second_bound_is_refused(tmp_path, bounds):
    save_checkpoint(tmp_path / "p.pt", make_network(LONGITUDINAL, "damped+idm", [8]), "two", 5)
    other = load_scenario(LONGITUDINAL, {"action": {"longitudinal": bounds}})
    with pytest.raises(CheckpointError, match=r"p\.pt: its action bounds are .*-2\.5.* changers"):
        load_checkpoint(tmp_path / "p.pt", other)


def test_a_followers_network_is_the_scenarios(tmp_path):
    scenario = load_scenario(
        "paper", {"followers": {"external": {"max_acceleration": 2.25, "max_braking": 4.1}}}
    )
    network = make_network(scenario, "mlp", [8], role=FOLLOWER)
    assert network.features == [feature.name for feature in FOLLOWER.features]
    assert network.config["action_low"] == [np.float32(-4.1)]
    assert network.config["action_high"] == [2.25]
    assert network.mu_name == "mlp"
    assert network.hidden_sizes == [8]
    typical = [[feature.offset + feature.scale for feature in FOLLOWER.features]]
    assert network.normalise(torch.tensor(typical)).allclose(torch.ones(1, len(FOLLOWER.features)))
    file = tmp_path / "f.pt"
    save_checkpoint(file, network, "paper", 3)
    assert load_follower(file, scenario)(np.zeros((5, 9), np.float32)).shape == (5,)
    with pytest.raises(CheckpointError, match=r"f\.pt: its action bounds"):
        load_follower(file, PAPER)


def test_one_kind_of_agent_is_not_the_other(path, tmp_path):
    with pytest.raises(CheckpointError, match=r"policy\.pt: its features"):
        load_follower(path, PAPER)
    save_checkpoint(tmp_path / "f.pt", make_network(PAPER, "mlp", [8], role=FOLLOWER), "paper", 3)
    with pytest.raises(CheckpointError, match=r"f\.pt: its features .* changers of .*'paper'"):
        load_checkpoint(tmp_path / "f.pt", PAPER)


def test_checkpoint_errors_are_value_errors():
    assert issubclass(CheckpointError, ValueError)


def test_a_cascades_network_knows_the_cost_of_the_yaw_acceleration():
    heavy = load_scenario("paper", {"reward": {"yaw_acceleration_weight": 3.0}})
    assert make_network(heavy, "cascade", [8]).action_costs == [3.0]
    assert make_network(LONGITUDINAL, "cascade+idm", [8]).action_costs == [2.0, 0.0]
    assert make_network(heavy, "cascade", [8], knows_action_cost=False).action_costs == [0.0]
    # These structures cannot say exactly 0: for them the parabola stands for the kink.
    for mu in ("paper", "damped", "mlp"):
        assert make_network(heavy, mu, [8]).action_costs == [0.0]
