"""Actions in every shape of the right size, and parts of bounds."""

import numpy as np
import pytest
import torch

from marl_lanes.envs.actions import read_action, scale_action


@pytest.mark.parametrize(
    "action",
    [
        0.25,
        np.float32(0.25),
        np.array(0.25),
        np.array([[0.25]]),
        [0.25],
        [[0.25]],
        torch.tensor(0.25),
        torch.tensor([[0.25]], requires_grad=True),
        torch.tensor(0.25, dtype=torch.bfloat16),
    ],
)
def test_an_action_of_one_number_has_any_shape(action):
    found = read_action("changer_0", action, 1)
    assert (found.shape, found.item()) == ((1,), 0.25)


def test_two_numbers_keep_their_order():
    assert read_action("changer_0", torch.tensor([[1.0], [2.0]]), 2).tolist() == [1.0, 2.0]


@pytest.mark.parametrize(
    "action",
    [np.zeros(2), [], None, "0.1", True, np.nan, [[0.0], [0.0, 1.0]], np.ma.masked_array([1.0])],
)
def test_another_size_or_kind_is_refused_in_one_line(action):
    with pytest.raises(ValueError, match=r"^actions\['changer_0'\][^\n]*must be[^\n]*$"):
        read_action("changer_0", action, 1)


@pytest.mark.parametrize("array", [np.array, torch.tensor])
def test_an_action_is_a_part_of_its_bound(array):
    low, high = array([-0.5, -3.0]), array([0.5, 2.0])
    for part, wanted in [(-1.0, [-0.5, -3.0]), (0.0, [0.0, 0.0]), (0.5, [0.25, 1.0])]:
        assert scale_action(array([part, part]), low, high).tolist() == wanted
