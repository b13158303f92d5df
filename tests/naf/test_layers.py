"""The box of actions, and the weights of networks."""

from copy import deepcopy

import pytest
import torch
from naf.paper_networks import make_network

from marl_lanes.naf.layers import ActionBox


def test_weights_of_another_shape_are_refused():
    network = make_network("paper")
    state = network.state_dict()
    for other in (torch.zeros(9), state["value.bias_0"].reshape(1, 1, -1)):
        with pytest.raises(RuntimeError, match="size mismatch"):
            network.load_state_dict(state | {"value.bias_0": other})


def test_the_half_range_follows_the_bounds():
    box = ActionBox([-1.0, 0.0], [1.0, 4.0])
    assert box.half_range.tolist() == [1.0, 2.0]
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
