"""The newest batch: every transition once an epoch, in parts of about one size."""

import pytest
import torch
from tensordict import TensorDict

from marl_lanes.training.config import EpochsConfig
from marl_lanes.training.experience import Epochs


def rows(count):
    return TensorDict({"number": torch.arange(count)}, [count])


@pytest.mark.parametrize(
    ("count", "num_parts"), [(0, 0), (1, 1), (5, 1), (100, 10), (104, 10), (106, 11)]
)
def test_each_epoch_goes_through_all_of_it_once(count, num_parts):
    experience = Epochs(EpochsConfig(num_epochs=3, batch_size=10))
    assert experience.num_due(0, 0) == 0
    experience.extend(rows(7))
    experience.extend(rows(count))
    due = experience.num_due(1000, 50)
    assert due == 3 * num_parts
    parts = list(experience.draw(due))
    assert len(parts) == due
    sizes = {len(part) for part in parts}
    assert not sizes or max(sizes) - min(sizes) <= 1
    epochs = []
    for epoch in range(3 if count else 0):
        numbers = [part["number"] for part in parts[epoch * num_parts : (epoch + 1) * num_parts]]
        epochs.append(torch.cat(numbers).tolist())
        assert sorted(epochs[-1]) == list(range(count))
    assert count < 10 or epochs[0] != epochs[1]


def test_fewer_updates_can_be_drawn():
    experience = Epochs(EpochsConfig(num_epochs=1, batch_size=10))
    experience.extend(rows(50))
    assert len(list(experience.draw(7))) == 7
    assert not list(experience.draw(0))
    assert experience.state() == {}
