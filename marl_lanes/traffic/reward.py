"""The named reward terms of a step, then their weighted sum."""

from typing import Any

from marl_lanes.traffic.compiled import internal


@internal
def reward(agent: Any, car: Any, deviation: float, turning: float, constants: Any) -> None:
    """-(w_acce |a| + w_rate |omega - c s'| + w_dev |dev|/d_avg), term by term, then the sum.

    Args:
        agent: record to write to; its failure term is set before.
        car: the agent's vehicle after the step; a is the yaw acceleration applied in it.
        deviation: lateral deviation after the step [m].
        turning: yaw rate relative to the road's own turning after the step [rad/s].
        constants: the scenario's constants.

    Source: Eq. 10-12.
    """
    agent.reward_acceleration = -constants.acceleration_weight * abs(car.yaw_acceleration)
    agent.reward_yaw_rate = -constants.yaw_rate_weight * abs(turning)
    agent.reward_deviation = (
        -constants.deviation_weight * abs(deviation) / constants.average_deviation
    )
    agent.reward = (
        agent.reward_acceleration
        + agent.reward_yaw_rate
        + agent.reward_deviation
        + agent.reward_failure
    )
