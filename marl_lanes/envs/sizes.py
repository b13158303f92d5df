"""Memory that a batched environment takes, known before any of it is allocated."""

from marl_lanes.envs.vehicle_table import state_columns
from marl_lanes.scenario import Scenario
from marl_lanes.traffic.placement import bytes_of_road
from marl_lanes.traffic.roles.changer import CHANGER
from marl_lanes.traffic.roles.follower import FOLLOWER

_BYTES_OF_SLOT = 32
"""Of an agent's masks, ends, rewards and outcome."""


def bytes_of_batched_road(scenario: Scenario, *, has_followers: bool, has_state: bool) -> int:
    """Memory of one road [bytes]: its state, the bounds in the specs, and the tensors of a step."""
    slots = scenario.num_slots
    tensors = 0
    for role in (CHANGER, FOLLOWER) if has_followers else (CHANGER,):
        numbers = len(role.seen(scenario)) + len(role.act(scenario))
        tensors += slots * (4 * numbers + _BYTES_OF_SLOT)
    state = bytes_of_state(scenario) if has_state else 0
    # Two bounds in the specs, two tensordicts for a step: before it and after it.
    return bytes_of_road(scenario) + 4 * tensors + state


def bytes_of_state(scenario: Scenario) -> int:
    """Memory of one road's ``state``, before a step and after it [bytes]."""
    return 8 * scenario.max_vehicles * len(state_columns(scenario))
