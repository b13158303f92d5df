"""The policies of the followers in a scenario's mix: passed in, registered, or learned."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from marl_lanes.envs.fit import check_fit
from marl_lanes.scenario import Scenario
from marl_lanes.scenario.dispositions import LEARNED
from marl_lanes.traffic.arguments import check_functions
from marl_lanes.traffic.roles.external import FollowerPolicy
from marl_lanes.traffic.roles.follower import FOLLOWER

if TYPE_CHECKING:
    from marl_lanes.naf.checkpoint import PolicyNetwork


def find_policies(
    scenario: Scenario,
    given: Mapping[str, FollowerPolicy] | None = None,
    *,
    has_learner: bool = False,
) -> dict[str, FollowerPolicy]:
    """The policies that ``Simulator`` does not find itself: passed in, or from the checkpoint.

    Args:
        scenario: its ``followers.mix`` names the policies.
        given: policies by name; they have priority.
        has_learner: whether a learner drives the ``learned`` followers, instead of the checkpoint.

    Raises:
        CheckpointError: ``followers.learned.checkpoint`` cannot be read, or does not fit the
            followers of this scenario.
        ValueError: ``given`` is no mapping of names to functions.
    """
    check_functions("follower_policies", given)
    policies = dict(given or {})
    checkpoint = scenario.followers.learned.checkpoint
    is_wanted = LEARNED in scenario.followers.external_names and LEARNED not in policies
    if is_wanted and checkpoint is not None and not has_learner:
        policies[LEARNED] = load_follower(Path(checkpoint), scenario)
    return policies


def load_follower(path: Path, scenario: Scenario) -> FollowerPolicy:
    """The greedy policy of a follower's checkpoint.

    Raises:
        CheckpointError: it cannot be read, or its features or bounds do not fit the scenario.
    """
    # Imported here, because an environment without a learned follower needs no torch.
    from marl_lanes.naf.checkpoint import read_checkpoint

    network = read_checkpoint(path).network
    check_fit(path, network, FOLLOWER, scenario)
    return follower_policy(network)


def follower_policy(network: "PolicyNetwork") -> FollowerPolicy:
    """The network's greedy action as a policy: observations (n, G) to accelerations (n,)."""
    from marl_lanes.naf.checkpoint import greedy_policy

    act = greedy_policy(network)

    def drive(observations: NDArray[np.float32]) -> NDArray[np.float64]:
        return act(observations)[:, 0]

    return drive
