"""The box of actions, and the weights of networks."""

from copy import deepcopy

import pytest
import torch
from naf.paper_networks import make_network

from marl_lanes.naf.layers import ActionBox


@pytest.mark.parametrize("mu", ["paper", "mlp"])
def test_weights_of_single_networks_as_stacks_of_one_are_read(mu):
    network, other = make_network(mu), make_network(mu)
    assert network.value.layer(0)[0].ndim == 2
    state = network.state_dict()
    stacked = dict(state)
    for key, value in state.items():
        if key.startswith(("value.", "factor_logits.")):
            stacked[key] = value.reshape(1, -1, value.shape[-1])
    assert stacked["value.bias_0"].shape == (1, 1, 16)
    other.load_state_dict(stacked)
    for key, value in state.items():
        assert torch.equal(other.state_dict()[key], value), key
    with pytest.raises(RuntimeError, match="size mismatch"):
        other.load_state_dict(state | {"value.bias_0": torch.zeros(9)})


def test_the_half_range_follows_the_bounds():
    box = ActionBox([-1.0, 0.0], [1.0, 4.0])
    assert box.half_range.tolist() == [1.0, 2.0]
    assert box.half_range is box.half_range
    box.load_state_dict({"low": torch.tensor([-3.0, 0.0]), "high": torch.tensor([3.0, 4.0])})
    assert box.half_range.tolist() == [3.0, 2.0]
    box.high += 2.0
    assert box.half_range.tolist() == [4.0, 3.0]
    copied = deepcopy(box).double()
    assert copied.half_range.dtype is torch.float64
    assert copied.half_range.tolist() == [4.0, 3.0]
    with torch.inference_mode():
        assert ActionBox([0.0], [1.0]).half_range.tolist() == [0.5]
    assert list(box.state_dict()) == ["low", "high"]
