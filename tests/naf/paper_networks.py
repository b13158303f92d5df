"""Networks with the paper's features, and observations for them."""

import torch
from tensordict import TensorDict

from marl_lanes.naf import NAFNetwork

PAPER = ["speed", "acceleration", "lateral_deviation", "yaw", "yaw_rate", "curvature"]
SCALES = [10.0, 2.0, 2.0, 0.1, 0.1, 0.01]
OFFSETS = [22.0, 0.0, 0.0, 0.0, 0.0, 0.0]


def make_network(mu="mlp", actions=1, bound=0.5, **kwargs):
    options = {"hidden_sizes": (16, 16), "offsets": OFFSETS, "scales": SCALES, **kwargs}
    return NAFNetwork(PAPER, [-bound] * actions, [bound] * actions, mu=mu, **options)


def make_observation(*batch):
    return torch.tensor(OFFSETS) + torch.tensor(SCALES) * torch.randn(*batch, len(PAPER))


def call(network, observation, action=None):
    data = TensorDict({"observation": observation}, observation.shape[:-1])
    return network(data if action is None else data.set("action", action))


def stir(network, scale=0.5):
    """Moves every parameter away from its initial value."""
    with torch.no_grad():
        for parameter in network.parameters():
            parameter += scale * torch.randn_like(parameter)
    return network


def state(**columns):
    row = {**dict.fromkeys(PAPER, 0.0), "speed": 22.0, **columns}
    return torch.tensor([row[name] for name in PAPER])
