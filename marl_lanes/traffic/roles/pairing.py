"""External followers: which driver is paired with which changer, what it sees, what it is paid."""

from typing import Any

from marl_lanes.traffic.machine.compiled import internal
from marl_lanes.traffic.machine.state import NONE, Disposition, Phase
from marl_lanes.traffic.roles.observation import observe_follower
from marl_lanes.traffic.roles.reward import reward_follower

_EXTERNAL = int(Disposition.EXTERNAL)
_ENGAGED = int(Phase.ENGAGED)
_ABORTING = int(Phase.ABORTING)


@internal
def clear_follower(follower: Any) -> None:
    """Empty a follower slot."""
    follower.vehicle = follower.policy = NONE
    follower.episode_reward = 0.0
    clear_reward(follower)


@internal
def clear_reward(follower: Any) -> None:
    """Nothing is paid for this step."""
    follower.reward = follower.reward_delay = follower.reward_abort = 0.0
    follower.reward_collision = follower.reward_discomfort = follower.reward_braking = 0.0


@internal
def find_driver(agent: Any, vehicles: Any) -> int:
    """Slot of the external driver behind the engaged changer in its target lane, or NONE."""
    slot = agent.target_follower
    if agent.phase != _ENGAGED or slot == NONE:
        return NONE
    driver = vehicles[slot]
    # Of two changers the nearer one counts; a driver with a command of its own has other cares.
    if driver.changer != agent.vehicle or driver.agent != NONE or driver.disposition < _EXTERNAL:
        return NONE
    return int(slot)


@internal
def pair(vehicles: Any, agents: Any, followers: Any, observations: Any, constants: Any) -> None:
    """Pay the drivers that acted in this step, then pair the engaged changers anew."""
    for index in range(agents.shape[0]):
        agent, follower = agents[index], followers[index]
        if agent.vehicle == NONE:
            clear_follower(follower)
            observations[index, :] = 0.0
            continue
        if follower.vehicle == NONE:
            clear_reward(follower)
            # A new command may have taken the slot in the step that freed it.
            follower.episode_reward = follower.episode_reward if agent.engaged_steps > 0 else 0.0
        else:
            reward_follower(follower, agent, vehicles, agent.phase == _ABORTING, constants)
        slot = find_driver(agent, vehicles)
        follower.vehicle = slot
        follower.policy = NONE if slot == NONE else vehicles[slot].disposition - _EXTERNAL
        observe_follower(agent, vehicles, constants, observations[index])
