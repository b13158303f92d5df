"""Networks with two actions, for every structure of mu."""

import numpy as np
import pytest
import torch
from naf.paper_networks import OFFSETS, SCALES

from marl_lanes.naf import NAFNetwork
from marl_lanes.naf.lateral import CascadeMu, DampedMu, GatedCascadeMu, PaperMu, SmoothCascadeMu
from marl_lanes.naf.mu import CarFollowingMu, MLPMu

FEATURES = [
    "speed",
    "car_following_acceleration",
    "lateral_deviation",
    "yaw",
    "yaw_rate",
    "curvature",
]
LOW, HIGH = [-0.5, -3.0], [0.5, 2.0]
HALF_RANGE = np.array([0.5, 2.5])
LATERAL = {
    "cascade": CascadeMu,
    "cascade-smooth": SmoothCascadeMu,
    "cascade-gated": GatedCascadeMu,
    "paper": PaperMu,
    "damped": DampedMu,
}
LONGITUDINAL = {"idm": CarFollowingMu, "mlp": MLPMu}
COMPOSED = [f"{first}+{second}" for first in LATERAL for second in LONGITUDINAL]

composed = pytest.mark.parametrize("mu", COMPOSED)
every = pytest.mark.parametrize("mu", [*COMPOSED, "mlp"])


def make_network(mu="paper+idm", low=LOW, high=HIGH, features=FEATURES, **kwargs):
    options = {"hidden_sizes": (16, 16), "offsets": OFFSETS, "scales": SCALES, **kwargs}
    return NAFNetwork(features, low, high, mu=mu, **options)


def make_action(*batch):
    low, high = torch.tensor(LOW), torch.tensor(HIGH)
    return low + (high - low) * torch.rand(*batch, 2)
