"""The collector of this process: its batches, its policy, and going on from a state."""

import pytest
import torch
from collecting import (
    NUM_ROADS,
    NUM_STEPS,
    assert_same_batch,
    deviation,
    make,
)

from marl_lanes.training.collectors import LocalCollector, take_roads

pytestmark = pytest.mark.filterwarnings(
    "ignore:Creating .* which inherits from WeightUpdaterBase:DeprecationWarning"
)

torch.set_num_threads(1)


@pytest.fixture
def collector():
    made = make(LocalCollector)
    yield made
    made.shutdown()


def test_what_is_restored_goes_on_identically(collector):
    collector.next()
    state, random = collector.state(), torch.get_rng_state()
    first = collector.next().clone()
    assert first.shape == (NUM_ROADS, NUM_STEPS)
    second = collector.next().clone()
    collector.restore(state)
    torch.set_rng_state(random)
    assert_same_batch(collector.next(), first)
    assert_same_batch(collector.next(), second)
    assert not torch.equal(first["changers", "action"], second["changers", "action"])


def test_a_state_of_another_number_of_workers_is_refused(collector):
    (state,) = collector.state()
    before = take_roads(collector.env)
    with pytest.raises(ValueError, match="training state of 2 workers: must be of 1"):
        collector.restore([state, state])
    assert torch.equal(take_roads(collector.env), before)


def test_the_policy_counts_from_the_next_batch_on(collector):
    assert collector.places == ()
    noise = collector.policy[1]
    noisy = torch.cat([deviation(collector, collector.next()) for _ in range(4)])
    assert noisy.abs().max() > 0.05 * noise.std.item()
    noise.sigma.fill_(0.0)
    before = [parameter.clone() for parameter in collector.policy.parameters()]
    with torch.no_grad():
        for parameter in collector.policy.parameters():
            parameter.add_(0.3)
    batch = collector.next().clone()
    assert deviation(collector, batch).abs().max() < 1e-5
    with torch.no_grad():
        for parameter, old in zip(collector.policy.parameters(), before, strict=True):
            parameter.copy_(old)
    assert deviation(collector, batch).abs().max() > 0.02
