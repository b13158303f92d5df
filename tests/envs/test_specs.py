"""The specs as they are made: every leaf with its shape, type and bounds, in this computer."""

import pytest
import torch

from marl_lanes import load_scenario
from marl_lanes.envs.specs import ENDS, make_specs
from marl_lanes.envs.vehicle_table import state_bounds
from marl_lanes.traffic.roles.changer import CHANGER
from marl_lanes.traffic.roles.follower import FOLLOWER

SCENARIO = load_scenario("interactive", {"num_slots": 3})
ROLES = (CHANGER, FOLLOWER)


def leaves(spec):
    return {key: (tuple(leaf.shape), leaf.dtype) for key, leaf in spec.items(True, True)}


def test_every_leaf_has_its_shape_and_type():
    specs = make_specs(SCENARIO, ROLES, 2, has_state=True)
    rows = SCENARIO.max_vehicles, len(state_bounds(SCENARIO, 3)[0][0])
    seen = {"state": ((2, *rows), torch.float32)}
    acted, paid, ended = {}, {}, dict.fromkeys(ENDS, ((2, 1), torch.bool))
    for role in ROLES:
        group = role.group
        seen[group, "observation"] = (2, 3, len(role.seen(SCENARIO))), torch.float32
        seen[group, "command_reward"] = (2, 3, 1), torch.float32
        seen |= {(group, key): ((2, 3), torch.bool) for key in ("mask", "acting")}
        acted[group, "action"] = (2, 3, len(role.act(SCENARIO))), torch.float32
        paid[group, "reward"] = (2, 3, 1), torch.float32
        ended |= {(group, key): ((2, 3, 1), torch.bool) for key in ENDS}
    seen |= {("changers", key): ((2, 3), torch.bool) for key in ("steering", "aborting")}
    seen["changers", "outcome"] = (2, 3), torch.int64
    assert tuple(map(leaves, specs)) == (seen, acted, paid, ended)
    assert all(spec.shape == (2,) for spec in specs)
    assert specs.observation["changers"].shape == (2, 3)


def test_without_followers_and_state_there_are_none():
    specs = make_specs(SCENARIO, (CHANGER,), 1, has_state=False)
    assert set(specs.observation.keys()) == {"changers"}
    assert set(specs.done.keys()) == {"changers", *ENDS}


@pytest.mark.parametrize("role", ROLES, ids=lambda role: role.name)
def test_bounds_are_those_of_the_role_in_every_slot(role):
    specs = make_specs(SCENARIO, ROLES, 2, has_state=True)
    group = role.group
    for leaf, bounds in (
        (specs.observation[group, "observation"], role.observation_bounds(SCENARIO)),
        (specs.action[group, "action"], role.action_bounds(SCENARIO)),
        (specs.observation["state"], state_bounds(SCENARIO, 3)),
    ):
        for found, wanted in zip((leaf.space.low, leaf.space.high), bounds, strict=True):
            assert (found == torch.tensor(wanted)).all()


def test_they_are_in_this_computer_whatever_torchs_default_is():
    with torch.device("meta"):
        specs = make_specs(SCENARIO, ROLES, 2, has_state=True)
    leaves = [leaf for spec in specs for leaf in spec.values(True, True)]
    assert {leaf.device.type for leaf in leaves} == {"cpu"}
