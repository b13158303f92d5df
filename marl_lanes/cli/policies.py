"""The policy of a name or a checkpoint."""

from pathlib import Path
from typing import Any

from marl_lanes.scenario import Scenario

UNTRAINED = (
    "tuned-cascade",
    "quintic",
    "mpc",
    "cascade-prior",
    "damped-prior",
    "lane-keeping",
    "random",
)
"""Names of the policies without learning."""


def make_policy(name: str, scenario: Scenario, seed: int) -> Any:
    """The policy with this name or from this checkpoint; it must fit the scenario.

    Args:
        name: a name of UNTRAINED, or the path of a checkpoint.
        scenario: the scenario that it drives on.
        seed: of the random policy's actions.

    Returns:
        A policy as ``run_maneuvers`` takes it.

    Raises:
        ValueError: the policy does not fit the scenario, or the file cannot be read or is no
            checkpoint.
    """
    from marl_lanes.evaluation import policies

    if name == "random":
        return policies.make_random_policy(scenario, seed)
    if name == "lane-keeping":
        return policies.make_lane_keeping_policy(scenario)
    if name == "tuned-cascade":
        return policies.make_tuned_cascade_policy(scenario)
    if name == "quintic":
        return policies.make_quintic_policy(scenario)
    if name == "mpc":
        return policies.make_mpc_policy(scenario)

    import torch

    from marl_lanes.naf.checkpoint import greedy_policy
    from marl_lanes.training.checkpoint import load_policy, make_network

    if name in UNTRAINED:
        torch.manual_seed(0)
        lateral = name.removesuffix("-prior")
        mu = lateral if scenario.action.longitudinal is None else f"{lateral}+idm"
        return greedy_policy(make_network(scenario, mu))
    if not Path(name).exists():
        names = ", ".join(UNTRAINED)
        raise ValueError(
            f"checkpoint {name}: cannot be read: there is no such file; without learning: {names}"
        )
    return greedy_policy(load_policy(Path(name), scenario).network)
