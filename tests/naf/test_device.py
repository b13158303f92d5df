"""Network and loss stay on one device: the meta device, which does not mix with others."""

import pytest
import torch
from tensordict import TensorDict

from marl_lanes import NAFLoss, NAFNetwork

FEATURES = [
    "speed",
    "lateral_deviation",
    "yaw",
    "yaw_rate",
    "curvature",
    "car_following_acceleration",
    "phase",
]
META = torch.device("meta")
pytestmark = pytest.mark.filterwarnings("ignore:No target network updater:UserWarning")


@pytest.mark.parametrize(
    "mu", ["cascade", "paper", "damped", "mlp", "cascade+idm", "paper+mlp", "damped+idm"]
)
@pytest.mark.parametrize("mu_frozen", [False, True])
def test_nothing_stays_on_the_cpu(mu, mu_frozen):
    actions = 2 if "+" in mu else 1
    low, high = [-0.5, -5.0][:actions], [0.5, 1.0][:actions]
    network = NAFNetwork(FEATURES, low, high, mu=mu, hidden_sizes=[8])
    # Values cached in a first use on the CPU must not be used again.
    network.policy().module(torch.zeros(3, len(FEATURES)))
    network.to(META)
    network.mu_frozen = mu_frozen
    loss = NAFLoss(network)
    loss.make_value_estimator(gamma=0.9)
    assert {one.device for one in loss.state_dict().values()} == {META}
    ends = {key: torch.zeros(4, 1, dtype=torch.bool, device=META) for key in ("done", "terminated")}
    observation = torch.zeros(4, len(FEATURES), device=META)
    following = {"observation": observation, "reward": torch.zeros(4, 1, device=META), **ends}
    rows = {"observation": observation, "action": torch.zeros(4, actions, device=META)}
    value = loss(TensorDict({**rows, "next": following}, [4]))["loss"]
    value.backward()
    assert value.device == META
    assert all(one.grad.device == META for one in network.value.parameters())
    assert network.policy().module(observation).device == META
