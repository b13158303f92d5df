"""Checkpoints: what is saved acts as before, with the scenario's features and bounds."""

import numpy as np
import pytest
import torch
from checkpoints import LONGITUDINAL, PAPER, trained

from marl_lanes import load_scenario
from marl_lanes.envs.followers import load_follower
from marl_lanes.naf.checkpoint import FORMAT, CheckpointError, greedy_policy, write_archive
from marl_lanes.traffic.roles.follower import FOLLOWER
from marl_lanes.training.checkpoint import (
    load_checkpoint,
    make_network,
    save_checkpoint,
)

torch.set_num_threads(1)


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


def test_a_policy_with_a_memory_acts_as_before_and_fits_its_scenario_alone(tmp_path):
    stacked = load_scenario("paper", {"observation": {"num_stacked": 40}})
    file = tmp_path / "p.pt"
    network = make_network(stacked, "mlp", [64, 64], encoder="gru")
    save_checkpoint(file, network, "paper", 1)
    found = load_checkpoint(file, stacked).network
    seen = np.tile(states(), (1, 40))
    assert np.array_equal(greedy_policy(found)(seen), greedy_policy(network)(seen))
    with pytest.raises(CheckpointError, match="speed@2"):
        load_checkpoint(file, PAPER)


def test_a_checkpoint_from_before_there_were_encoders_has_none(tmp_path):
    network = trained()
    config = {key: value for key, value in network.config.items() if key != "encoder"}
    content = {"format": FORMAT, "config": config, "weights": network.state_dict()}
    write_archive(tmp_path / "p.pt", content | {"scenario": "paper", "transitions": 0})
    found = load_checkpoint(tmp_path / "p.pt", PAPER).network
    assert found.encoder_name == "none"
    assert np.array_equal(greedy_policy(found)(states()), greedy_policy(network)(states()))


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


def test_a_cascades_network_knows_the_cost_of_the_yaw_acceleration():
    heavy = load_scenario("paper", {"reward": {"yaw_acceleration_weight": 3.0}})
    assert make_network(heavy, "cascade", [8]).action_costs == [3.0]
    assert make_network(LONGITUDINAL, "cascade+idm", [8]).action_costs == [2.0, 0.0]
    assert make_network(heavy, "cascade", [8], knows_action_cost=False).action_costs == [0.0]
    # These structures cannot say exactly 0: for them the parabola stands for the kink.
    for mu in ("paper", "damped", "mlp"):
        assert make_network(heavy, mu, [8]).action_costs == [0.0]
