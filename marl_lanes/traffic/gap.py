"""Gap selection: acceptance, and the same check again at every step."""

from typing import Any

from marl_lanes.traffic.compiled import compiled, internal
from marl_lanes.traffic.neighbors import bumper_gap
from marl_lanes.traffic.state import NONE


@compiled
def is_gap_safe(rear: Any, front: Any, constants: Any) -> bool:
    """Whether gap >= d_min + tau v_rear + max(0, v_rear - v_front)^2/(2 b_max)."""
    closing = max(0.0, rear.speed - front.speed)
    needed = (
        constants.gap_minimum
        + constants.gap_time * rear.speed
        + closing * closing / (2.0 * constants.gap_max_braking)
    )
    return bool(bumper_gap(rear, front, constants) >= needed)


@internal
def is_target_gap_safe(agent: Any, vehicles: Any, constants: Any) -> bool:
    """Whether the gaps to the target lane's leader and follower are both safe."""
    car = vehicles[agent.vehicle]
    if agent.target_leader > NONE and not is_gap_safe(
        car, vehicles[agent.target_leader], constants
    ):
        return False
    return agent.target_follower == NONE or is_gap_safe(
        vehicles[agent.target_follower], car, constants
    )
