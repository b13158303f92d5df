"""The named reward terms of a step, then their weighted sum."""

from typing import Any

from marl_lanes.traffic.flow.collisions import COLLIDES
from marl_lanes.traffic.machine.compiled import internal
from marl_lanes.traffic.road.geometry import is_body_in


@internal
def reward(agent: Any, car: Any, deviation: float, turning: float, constants: Any) -> None:
    """-(w_acce |a| + w_rate |omega - c s'| + w_dev |dev|/d_avg) of a steering agent, term by term.

    Args:
        agent: record to write to.
        car: the agent's vehicle after the step; a is the yaw acceleration applied in it.
        deviation: lateral deviation after the step [m].
        turning: yaw rate relative to the road's own turning after the step [rad/s].
        constants: the scenario's constants.

    Source: Eq. 10, Eq. 11 and Eq. 12.
    """
    agent.reward_acceleration = -constants.acceleration_weight * abs(car.yaw_acceleration)
    agent.reward_yaw_rate = -constants.yaw_rate_weight * abs(turning)
    agent.reward_deviation = (
        -constants.deviation_weight * abs(deviation) / constants.average_deviation
    )


@internal
def sum_terms(agent: Any, car: Any, constants: Any) -> None:
    """Add -(w_delay dt + w_lng (a_lng - a_following)^2) of every live agent, then sum all terms.

    The terms of ``reward`` and the failure's are set before.
    """
    agent.reward_delay = -constants.delay_weight * constants.time_step
    agent.reward_longitudinal = 0.0
    if constants.has_longitudinal:
        departure = car.acceleration - agent.car_following
        agent.reward_longitudinal = -constants.longitudinal_weight * departure * departure
    agent.reward = (
        agent.reward_acceleration
        + agent.reward_yaw_rate
        + agent.reward_deviation
        + agent.reward_failure
        + agent.reward_delay
        + agent.reward_longitudinal
    )
    agent.episode_reward += agent.reward


@internal
def reward_follower(follower: Any, agent: Any, vehicles: Any, has_aborted: bool, c: Any) -> None:
    """What a paired driver is paid for a step, term by term, then the sum.

    w_delay dt while the changer's body is not in its target lane, w_abort for an abort, minus the
    penalty for a collision, w_discomfort a^2 and w_braking (-a - hard_braking) where positive.

    Args:
        follower: record to write to; its ``vehicle`` is the driver that acted.
        agent: the changer's record after the step.
        vehicles: the vehicle table after the step.
        has_aborted: whether the changer was turned back in this step.
        c: the scenario's constants.
    """
    driver, changer = vehicles[follower.vehicle], vehicles[agent.vehicle]
    has_entered = is_body_in(changer, agent.target_lane)
    braking = max(0.0, -driver.acceleration - c.follower_hard_braking)
    follower.reward_delay = 0.0 if has_entered else c.follower_delay_weight * c.time_step
    follower.reward_abort = c.follower_abort_weight if has_aborted else 0.0
    follower.reward_collision = -c.follower_collision_penalty if driver.fate == COLLIDES else 0.0
    follower.reward_discomfort = -c.follower_discomfort_weight * driver.acceleration**2
    follower.reward_braking = -c.follower_braking_weight * braking
    follower.reward = (
        follower.reward_delay
        + follower.reward_abort
        + follower.reward_collision
        + follower.reward_discomfort
        + follower.reward_braking
    )
    follower.episode_reward += follower.reward
