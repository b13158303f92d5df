"""The gap rule: acceptance of a gap, and the same check in every later step."""

from typing import Any

from marl_lanes.traffic.following.car_following import follow_plainly
from marl_lanes.traffic.machine.compiled import compiled, internal
from marl_lanes.traffic.machine.state import NONE, Phase
from marl_lanes.traffic.road.neighbors import bumper_gap

_WAITING = int(Phase.WAITING)


@compiled
def is_gap_wide(rear: Any, front: Any, profiles: Any, constants: Any) -> bool:
    """Rule kinematic: gap >= d_min + tau v_rear + max(0, v_rear - v_front)^2/(2 b_max)."""
    closing = max(0.0, rear.speed - front.speed)
    needed = (
        constants.gap_minimum
        + constants.gap_time * rear.speed
        + closing * closing / (2.0 * constants.gap_max_braking)
    )
    return bool(bumper_gap(rear, front, profiles) >= needed)


@internal
def is_following_safe(rear: Any, front: Any, braking: float, profiles: Any, constants: Any) -> bool:
    """Rule car_following: gap >= d_min, and the rear driver's acceleration >= -braking.

    Source: the safety criterion of MOBIL; Kesting, Treiber, Helbing 2007, eq. 2.
    """
    if bumper_gap(rear, front, profiles) < constants.gap_minimum:
        return False
    return bool(follow_plainly(rear, front, profiles, constants) >= -braking)


@internal
def is_gap_safe(rear: Any, front: Any, braking: float, profiles: Any, constants: Any) -> bool:
    """Whether the scenario's gap rule holds between two vehicles, with b_safe = ``braking``."""
    if constants.is_gap_kinematic:
        return bool(is_gap_wide(rear, front, profiles, constants))
    return bool(is_following_safe(rear, front, braking, profiles, constants))


@internal
def is_target_gap_safe(agent: Any, vehicles: Any, profiles: Any, constants: Any) -> bool:
    """Whether the gaps to the target lane's leader and follower are both safe.

    For a waiting agent with a margin: without it agents would often abort in the step after they
    engage.
    """
    car = vehicles[agent.vehicle]
    braking = constants.gap_safe_braking
    if agent.phase == _WAITING:
        braking -= constants.gap_braking_margin
    if agent.target_leader > NONE and not is_gap_safe(
        car, vehicles[agent.target_leader], braking, profiles, constants
    ):
        return False
    return agent.target_follower == NONE or is_gap_safe(
        vehicles[agent.target_follower], car, braking, profiles, constants
    )
