"""Which networks fit a role on a scenario."""

import textwrap
from pathlib import Path
from typing import TYPE_CHECKING, Any

from marl_lanes.scenario import Scenario
from marl_lanes.traffic.roles.role import Role

if TYPE_CHECKING:
    from marl_lanes.naf.checkpoint import PolicyNetwork


def network_form(role: Role, scenario: Scenario) -> dict[str, Any]:
    """What a network for the role must be made with, in plain Python types.

    Returns:
        ``features``, ``offsets`` and ``scales`` of the observation, ``action_low`` and
        ``action_high``.
    """
    seen = role.seen(scenario)
    low, high = role.action_bounds(scenario)
    return {
        "features": [feature.name for feature in seen],
        "offsets": [feature.offset for feature in seen],
        "scales": [feature.scale for feature in seen],
        "action_low": low.tolist(),
        "action_high": high.tolist(),
    }


def check_fit(path: Path, network: "PolicyNetwork", role: Role, scenario: Scenario) -> None:
    """Refuse the network of a checkpoint that has other features or other action bounds.

    Raises:
        CheckpointError: it does not fit.
    """
    # Imported here, because an environment without a learned follower needs no torch.
    from marl_lanes.naf.checkpoint import CheckpointError

    wanted = network_form(role, scenario)
    whose = f"the {role.group} of scenario {scenario.name!r} have"
    if network.features != wanted["features"]:
        raise CheckpointError(
            f"checkpoint {path}: its features are {textwrap.shorten(str(network.features), 400)}, "
            f"{whose} {wanted['features']}"
        )
    found, needed = (
        f"{form['action_low']} to {form['action_high']}" for form in (network.config, wanted)
    )
    if found != needed:
        raise CheckpointError(f"checkpoint {path}: its action bounds are {found}, {whose} {needed}")
