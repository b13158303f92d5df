"""Opponents: how often each is met, and who drives on which road."""

import pytest
import torch
from tensordict import TensorDict
from torch import nn

from marl_lanes.training.opponents import PoolPolicy, allot, prioritise


def test_opponents_that_win_are_met_more_often():
    shares = prioritise([0.9, 0.5, 0.6], 1.0)
    assert shares.tolist() == pytest.approx([0.1, 0.5, 0.4])
    squared = prioritise([0.9, 0.5, 0.6], 2.0)
    assert squared.tolist() == pytest.approx([1 / 42, 25 / 42, 16 / 42])


@pytest.mark.parametrize(("won", "exponent"), [([0.9, 0.1, 0.5], 0.0), ([1.0, 1.0, 1.0], 2.0)])
def test_without_a_difference_all_are_met_alike(won, exponent):
    assert prioritise(won, exponent).tolist() == pytest.approx([1 / 3] * 3)


def test_who_is_always_beaten_is_not_met():
    assert prioritise([1.0, 0.5], 1.0).tolist() == [0.0, 1.0]


def test_things_are_divided_by_the_shares():
    assert allot([0.25, 0.75], 8).tolist() == [2, 6]
    assert allot([1 / 3, 1 / 3, 1 / 3], 10).sum() == 10
    assert allot([0.001, 0.999], 16).tolist() == [0, 16]


class Constant(nn.Module):
    def __init__(self, value):
        super().__init__()
        self.value = value

    def forward(self, observation):
        assert observation.ndim == 2
        return torch.full((len(observation), 2), self.value)


def test_each_changer_drives_on_its_roads_alone():
    policy = PoolPolicy([Constant(1.0), Constant(2.0), Constant(3.0)], [2, 0, 1], 2)
    acting = torch.tensor([[True, False], [True, True], [False, True]])
    group = {"observation": torch.zeros(3, 2, 5), "acting": acting}
    action = policy(TensorDict({"changers": group}, [3]))["changers", "action"]
    assert action[..., 0].tolist() == [[1.0, 0.0], [1.0, 1.0], [0.0, 3.0]]
    assert torch.equal(action[..., 0], action[..., 1])
