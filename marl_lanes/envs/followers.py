"""The policies of the followers that a scenario's mix names: given, registered, or learned."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from marl_lanes.scenario import Scenario
from marl_lanes.scenario.followers import LEARNED
from marl_lanes.traffic.parameters import follower_action_bounds
from marl_lanes.traffic.roles.external import FOLLOWER_COLUMNS, FollowerPolicy, registered_follower

if TYPE_CHECKING:
    from marl_lanes.naf.network import NAFNetwork


def find_policies(
    scenario: Scenario,
    given: Mapping[str, FollowerPolicy] | None = None,
    *,
    has_learner: bool = False,
) -> dict[str, FollowerPolicy]:
    """The policies for ``Simulator``: those given, those registered, that of the checkpoint.

    Args:
        scenario: whose ``followers.mix`` names them.
        given: policies by name, before all others.
        has_learner: whether a learner drives the ``learned`` ones, and no checkpoint.

    Raises:
        CheckpointError: ``followers.learned.checkpoint`` cannot be read, or is no follower's of
            this scenario.
    """
    policies = dict(given or {})
    for name in scenario.followers.external_names:
        registered = registered_follower(name)
        if name not in policies and registered is not None:
            policies[name] = registered
    checkpoint = scenario.followers.learned.checkpoint
    is_wanted = LEARNED in scenario.followers.external_names and LEARNED not in policies
    if is_wanted and checkpoint is not None and not has_learner:
        policies[LEARNED] = load_follower(Path(checkpoint), scenario)
    return policies


def load_follower(path: Path, scenario: Scenario) -> FollowerPolicy:
    """The greedy policy of a follower's checkpoint.

    Raises:
        CheckpointError: it cannot be read, or its features or bounds are not the scenario's.
    """
    # Imported here: an environment without a learned follower needs no torch.
    from marl_lanes.naf.checkpoint import CheckpointError, read_checkpoint

    network = read_checkpoint(path).network
    wanted = list(FOLLOWER_COLUMNS)
    if network.features != wanted:
        raise CheckpointError(
            f"follower checkpoint {path}: its features are {network.features}, a follower has "
            f"{wanted}"
        )
    low, high = follower_action_bounds(scenario)
    found = network.config["action_low"], network.config["action_high"]
    if found != (low.tolist(), high.tolist()):
        raise CheckpointError(
            f"follower checkpoint {path}: its action bounds are {found}, followers.external of "
            f"scenario {scenario.name!r} has {(low.tolist(), high.tolist())}"
        )
    return follower_policy(network)


def follower_policy(network: "NAFNetwork") -> FollowerPolicy:
    """The network's greedy action as a driver: observations (n, G) to accelerations (n,)."""
    from marl_lanes.naf.checkpoint import greedy_policy

    act = greedy_policy(network)

    def drive(observations: NDArray[np.float32]) -> NDArray[np.float64]:
        return act(observations)[:, 0]

    return drive
