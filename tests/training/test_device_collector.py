"""A collector that waits for nothing: its batches are those of the collector of the CPU."""

from functools import partial

import pytest
import torch
from collecting import NUM_ROADS, NUM_STEPS, assert_same_batch, make

from marl_lanes.training import graphs
from marl_lanes.training.collectors import LocalCollector, take_roads
from marl_lanes.training.device_collector import DeviceCollector

pytestmark = pytest.mark.filterwarnings(
    "ignore:Creating .* which inherits from WeightUpdaterBase:DeprecationWarning"
)
torch.set_num_threads(1)


def batches(collector, number):
    torch.manual_seed(5)
    found = [collector.next().clone() for _ in range(number)]
    collector.shutdown()
    return found


@pytest.mark.parametrize("is_graphed", [False, True])
def test_its_batches_are_those_of_the_local_collector(monkeypatch, is_graphed):
    monkeypatch.setattr(graphs, "capture", lambda function: function)
    kind = partial(DeviceCollector, is_graphed=is_graphed)
    number = graphs.NUM_WARMUPS + 2
    one, other = batches(make(LocalCollector), number), batches(make(kind), number)
    assert other[0].shape == (NUM_ROADS, NUM_STEPS)
    for pair in zip(one, other, strict=True):
        assert_same_batch(*pair)


def test_what_is_restored_goes_on_identically():
    collector = make(DeviceCollector)
    collector.next()
    state, random = collector.state(), torch.get_rng_state()
    first, second = collector.next().clone(), collector.next().clone()
    collector.restore(state)
    torch.set_rng_state(random)
    assert_same_batch(collector.next(), first)
    assert_same_batch(collector.next(), second)
    assert not torch.equal(first["changers", "action"], second["changers", "action"])
    before = take_roads(collector.env)
    with pytest.raises(ValueError, match="training state of 2 workers: must be of 1"):
        collector.restore([*state, *state])
    assert torch.equal(take_roads(collector.env), before)
