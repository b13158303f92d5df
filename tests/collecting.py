"""Busy roads, a network and its noise, for tests of the collectors."""

import torch
from tensordict.nn import TensorDictSequential
from torchrl.modules import AdditiveGaussianModule

from marl_lanes import LaneChangeEnv
from marl_lanes.training.checkpoint import make_network
from marl_lanes.training.transitions import LivePolicy

BUSY = {
    "num_agents": None,
    "horizon": None,
    "departures": {"interval": [1.5, 3.0]},
    "command": {"probability": 1.0},
    "num_slots": 4,
    "road": {"length": 400.0},
    "warmup": [20.0, 30.0],
}
NUM_ROADS = 8
NUM_STEPS = 10
SEED = 3


def make_policy(env, sigma=0.1):
    """The policy and its noise; the same weights each time."""
    torch.manual_seed(11)
    network = make_network(env.scenario, "damped", [8])
    noise = AdditiveGaussianModule(
        env.full_action_spec,
        action_key=("changers", "action"),
        sigma_init=sigma,
        sigma_end=0.0,
    )
    noise.std = network.box.half_range
    return TensorDictSequential(LivePolicy(network.policy().module, 1), noise)


def make(kind, *arguments, num_workers=1, sigma=0.1):
    """A collector, its roads those of SEED."""
    env = LaneChangeEnv("paper", NUM_ROADS // num_workers, overrides=BUSY, seed=SEED)
    return kind(env, make_policy(env, sigma), NUM_STEPS, *arguments)


def deviation(collector, batch):
    """Distance of the actions from the present policy: (N,), of the acting agents."""
    acting = batch["changers", "acting"]
    with torch.no_grad():
        wanted = collector.policy[0].policy(batch["changers", "observation"][acting])
    return (batch["changers", "action"][acting] - wanted).flatten()


def assert_workers_take_the_policy(collector):
    """Actions follow the weights and sigma of this process once they are sent, and not before."""
    noise = collector.policy[1]
    half_range = noise.std.item()
    noise.sigma.fill_(0.1)
    batches = [collector.next() for _ in range(4)]
    wide = torch.cat([deviation(collector, batch) for batch in batches])
    assert wide.numel() > 100
    assert 0.08 < wide.std().item() / half_range < 0.12
    # In separate memory, so that the workers get it only when it is sent.
    with torch.no_grad():
        for tensor in [*collector.policy.parameters(), *collector.policy.buffers()]:
            tensor.set_(tensor.clone())
    noise.sigma.fill_(0.0)
    with torch.no_grad():
        for parameter in collector.policy.parameters():
            parameter.add_(0.3)
    stale = deviation(collector, next(collector._batches))
    assert stale.abs().max() > 0.02
    sent = deviation(collector, collector.next())
    assert sent.numel() > 20
    assert sent.abs().max() < 1e-5


def assert_same_batch(one, other):
    """Bit for bit."""
    # Trajectory ids continue to count after a restore.
    one, other = (batch.exclude("collector") for batch in (one, other))
    keys = set(one.keys(True, True)) | set(other.keys(True, True))
    assert len(keys) > 20
    for key in keys:
        assert torch.equal(one[key], other[key]), key
