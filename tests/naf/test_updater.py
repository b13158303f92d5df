"""The target's update in one call is TorchRL's."""

from copy import deepcopy

import pytest
import torch
from naf.helpers import make_data, make_network
from torchrl.objectives import SoftUpdate

from marl_lanes.naf import NAFLoss
from marl_lanes.naf.joined import join_parameters
from marl_lanes.naf.updater import ForeachSoftUpdate


@pytest.mark.parametrize("num_joined", [0, 2, None])
@pytest.mark.parametrize("rate", [{"tau": 0.02}, {"eps": 0.9}, {"tau": 1.0 / 3.0}])
def test_it_gives_what_soft_update_gives(rate, num_joined):
    network = make_network()
    other = NAFLoss(deepcopy(network))
    if num_joined != 0:
        for part in (network.value, network.mu):
            join_parameters(list(part.parameters())[:num_joined])
    loss = NAFLoss(network)
    other.load_state_dict(loss.state_dict())
    ours, theirs = ForeachSoftUpdate(loss, **rate), SoftUpdate(other, **rate)
    before = loss.target_value_network_params.clone()
    for _ in range(3):
        noise = [torch.randn_like(parameter) for parameter in loss.parameters()]
        for one in (loss, other):
            with torch.no_grad():
                for parameter, step in zip(one.parameters(), noise, strict=True):
                    parameter += step
        ours.step()
        theirs.step()
    mine, expected = loss.target_value_network_params, other.target_value_network_params
    trained = {name for name, _ in loss.value_network.named_parameters()}
    for key, value in expected.items(True, True):
        assert torch.equal(mine[key], value), key
        assert torch.equal(before[key], value) is (".".join(key) not in trained), key
    # The networks are as they were but for the noise, and the targets stay without gradients.
    for one, same in zip(loss.parameters(), other.parameters(), strict=True):
        assert torch.equal(one, same)
    assert not any(value.requires_grad for value in mine.values(True, True))


def test_its_arguments_are_those_of_soft_update():
    with pytest.raises(ValueError, match="One and only one argument"):
        ForeachSoftUpdate(NAFLoss(make_network()), tau=0.1, eps=0.9)
    with pytest.raises(RuntimeError, match="Did not find any target"):
        ForeachSoftUpdate(NAFLoss(make_network(), delay_value=False), tau=0.1)
    updater = ForeachSoftUpdate(NAFLoss(make_network()), tau=0.1)
    updater.initialized = False
    with pytest.raises(RuntimeError, match="init_"):
        updater.step()


def test_the_loss_knows_that_it_has_one(recwarn):
    loss = NAFLoss(make_network())
    ForeachSoftUpdate(loss, tau=0.1)
    loss(make_data())
    assert not [warning for warning in recwarn if "target network updater" in str(warning.message)]
