"""Small networks, batches and losses."""

import contextlib

import torch
from tensordict import TensorDict, assert_allclose_td
from torchrl.objectives import SoftUpdate, ValueEstimators

from marl_lanes.naf import NAFLoss, NAFNetwork

SUPPORTED = [ValueEstimators.TD0, ValueEstimators.TD1, ValueEstimators.TDLambda]
FEATURES = ["speed", "lateral_deviation", "yaw", "yaw_rate", "curvature"]


def make_network(actions=2, **kwargs):
    options = {"mu": "mlp", "hidden_sizes": (8,), **kwargs}
    return NAFNetwork(FEATURES, [-1.0] * actions, [1.0] * actions, **options)


def make_data(*batch, actions=2, reward="reward", done="done", terminated="terminated"):
    batch = batch or (8,)
    return TensorDict(
        {
            "observation": torch.randn(*batch, len(FEATURES)),
            "action": torch.rand(*batch, actions) * 2 - 1,
            "next": {
                "observation": torch.randn(*batch, len(FEATURES)),
                reward: torch.randn(*batch, 1),
                done: torch.zeros(*batch, 1, dtype=torch.bool),
                terminated: torch.zeros(*batch, 1, dtype=torch.bool),
            },
        },
        batch,
        names=[None, "time"] if len(batch) == 2 else None,
    )


def make_loss(network=None, **kwargs):
    """A loss with its target updater, so that nothing warns."""
    loss = NAFLoss(make_network() if network is None else network, **kwargs)
    if loss.delay_value:
        SoftUpdate(loss, eps=0.5)
    return loss


@contextlib.contextmanager
def unchanged(data):
    """Checks that the entries present at the start do not change."""
    before = data.clone()
    yield
    assert_allclose_td(data.select(*before.keys(True, True)), before)
