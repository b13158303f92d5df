"""Which networks fit a role on a scenario."""

import json

import pytest
import torch
from checkpoints import LONGITUDINAL, PAPER

from marl_lanes import load_scenario
from marl_lanes.envs.fit import network_form
from marl_lanes.envs.followers import load_follower
from marl_lanes.naf.checkpoint import CheckpointError
from marl_lanes.traffic.roles.changer import CHANGER
from marl_lanes.traffic.roles.follower import FOLLOWER
from marl_lanes.training.checkpoint import (
    load_checkpoint,
    make_network,
    save_checkpoint,
)

torch.set_num_threads(1)


@pytest.mark.parametrize(
    "features",
    [
        ["speed", "lateral_deviation", "yaw", "yaw_rate", "curvature"],
        ["acceleration", "speed", "lateral_deviation", "yaw", "yaw_rate", "curvature"],
        [*PAPER.observation.features, "time"],
    ],
)
def test_other_features_are_refused(policy_file, features):
    other = load_scenario("paper", {"observation": {"features": features}})
    with pytest.raises(CheckpointError, match=r"policy\.pt.*features") as caught:
        load_checkpoint(policy_file, other)
    assert str(features) in str(caught.value)
    assert str(list(PAPER.observation.features)) in str(caught.value)


@pytest.mark.parametrize("bound", [0.4, 0.6])
def test_another_bound_is_refused(policy_file, bound):
    other = load_scenario("paper", {"action": {"max_yaw_acceleration": bound}})
    with pytest.raises(CheckpointError, match=rf"policy\.pt.*0\.5.*{bound}"):
        load_checkpoint(policy_file, other)


@pytest.mark.parametrize("bounds", [{"max_braking": 2.0}, {"max_acceleration": 2.0}, None])
def test_another_second_bound_is_refused(tmp_path, bounds):
    save_checkpoint(tmp_path / "p.pt", make_network(LONGITUDINAL, "damped+idm", [8]), "two", 5)
    other = load_scenario(LONGITUDINAL, {"action": {"longitudinal": bounds}})
    with pytest.raises(CheckpointError, match=r"p\.pt: its action bounds are .*-2\.5.* changers"):
        load_checkpoint(tmp_path / "p.pt", other)


def test_one_kind_of_agent_is_not_the_other(policy_file, tmp_path):
    with pytest.raises(CheckpointError, match=r"policy\.pt: its features"):
        load_follower(policy_file, PAPER)
    save_checkpoint(tmp_path / "f.pt", make_network(PAPER, "mlp", [8], role=FOLLOWER), "paper", 3)
    with pytest.raises(CheckpointError, match=r"f\.pt: its features .* changers of .*'paper'"):
        load_checkpoint(tmp_path / "f.pt", PAPER)


def test_a_networks_form_is_the_roles_on_the_scenario():
    form = network_form(CHANGER, LONGITUDINAL)
    assert form["features"] == list(LONGITUDINAL.observation.features)
    assert (form["action_low"], form["action_high"]) == ([-0.5, -2.5], [0.5, 1.5])
    assert form["offsets"][:2] == [20.0, 0.0]
    assert form["scales"][:2] == [10.0, 2.0]
    # In plain types, which a checkpoint can hold.
    assert json.loads(json.dumps(form)) == form
    follower = network_form(FOLLOWER, PAPER)
    assert follower["features"] == [feature.name for feature in FOLLOWER.features]
    assert (follower["action_low"], follower["action_high"]) == ([-3.0], [3.0])
