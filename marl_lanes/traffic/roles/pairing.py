"""External followers: pairs of driver and changer, their observations and rewards."""

from typing import Any

from marl_lanes.traffic.command.phases import clear_payment
from marl_lanes.traffic.machine.compiled import internal
from marl_lanes.traffic.machine.state import NONE, Disposition, Phase
from marl_lanes.traffic.machine.team import member, team_size
from marl_lanes.traffic.roles.follower import Step, observe_follower, pay_follower

_EXTERNAL = int(Disposition.EXTERNAL)
_ENGAGED = int(Phase.ENGAGED)
_ABORTING = int(Phase.ABORTING)


@internal
def clear_follower(follower: Any) -> None:
    """Empty a follower slot."""
    follower.vehicle = follower.policy = NONE
    follower.episode_reward = 0.0
    clear_payment(follower)


@internal
def find_driver(agent: Any, vehicles: Any) -> int:
    """Slot of the external driver behind the engaged changer in its target lane, or NONE."""
    slot = agent.target_follower
    if agent.phase != _ENGAGED or slot == NONE:
        return NONE
    driver = vehicles[slot]
    # Only the nearest changer counts. A driver with a command of its own is not paired.
    if driver.changer != agent.vehicle or driver.agent != NONE or driver.disposition < _EXTERNAL:
        return NONE
    return int(slot)


@internal
def pair(scene: Any, followers: Any, observations: Any, features: Any) -> None:
    """Reward the drivers that acted in this step, then pair the engaged changers again."""
    agents, vehicles, c = scene.agents, scene.vehicles, scene.constants
    for index in range(member(), agents.shape[0], team_size()):
        agent, follower = agents[index], followers[index]
        if agent.vehicle == NONE:
            clear_follower(follower)
            observations[index, :] = 0.0
            continue
        changer = vehicles[agent.vehicle]
        if follower.vehicle == NONE:
            clear_payment(follower)
            # A new command may have got the slot in the step that freed it.
            follower.episode_reward = follower.episode_reward if agent.steering_steps > 0 else 0.0
        else:
            driver, has_aborted = vehicles[follower.vehicle], agent.phase == _ABORTING
            step = Step(driver, agent, changer, has_aborted, c)
            pay_follower(follower, c.follower_weights, step)
        slot = find_driver(agent, vehicles)
        follower.vehicle = slot
        follower.policy = NONE if slot == NONE else vehicles[slot].disposition - _EXTERNAL
        if agent.target_follower == NONE:
            observations[index, :] = 0.0
        else:
            behind = vehicles[agent.target_follower]
            observe_follower(features, observations[index], agent, behind, changer, scene)
