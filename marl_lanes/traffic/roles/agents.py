"""What a step does with live agents: rewards and outcomes; then neighbors, phases, observations.

Every array argument is one road's row of the state.
"""

from typing import Any

from marl_lanes.traffic.command.outcome import find_outcome
from marl_lanes.traffic.command.phases import (
    end_commands,
    enter_phase,
    is_steering,
    lateral_deviation,
    next_phase,
)
from marl_lanes.traffic.machine.compiled import internal
from marl_lanes.traffic.machine.state import NONE, Outcome, Phase
from marl_lanes.traffic.machine.team import any_member, is_team, member, team_size
from marl_lanes.traffic.road.geometry import road_turn_rate
from marl_lanes.traffic.road.neighbors import find_agent_neighbors, find_rank
from marl_lanes.traffic.roles.changer import Step, observe_changer, pay_changer

_ABSENT = int(Phase.ABSENT)
_ENGAGED = int(Phase.ENGAGED)
_UNFINISHED = int(Outcome.UNFINISHED)


@internal
def judge(scene: Any, observations: Any, features: Any) -> None:
    """Set the reward of every live agent for the step, and end the commands that are over."""
    road, vehicles, order, agents = scene.road, scene.vehicles, scene.order, scene.agents
    arcs, constants = scene.arcs, scene.constants
    has_ended = False
    index, unseen = member() - team_size(), road.num_live
    while unseen > 0 and index + team_size() < agents.shape[0]:
        index += team_size()
        agent = agents[index]
        if agent.phase == _ABSENT:
            continue
        unseen -= 1
        car = vehicles[agent.vehicle]
        deviation = lateral_deviation(agent, car, constants)
        turning = car.yaw_rate - road_turn_rate(car, arcs)
        outcome = find_outcome(agent, car, deviation, turning, road, constants)
        if is_steering(agent):
            agent.steering_steps += 1
        step = Step(agent, car, deviation, turning, outcome, constants)
        pay_changer(agent, constants.changer_weights, step)
        if outcome == _UNFINISHED:
            continue
        rank = find_rank(agent.vehicle, order)
        find_agent_neighbors(agent, rank, order, road.num_vehicles, vehicles, agents)
        observe_changer(features, observations[index], agent, car, scene)
        agent.outcome = outcome
        has_ended = True
    if any_member(has_ended) and member() == 0:
        # After all observations: until it ends, an engaged agent counts as in its target lane.
        end_commands(road, vehicles, agents, scene.profiles, constants)


@internal
def _visit_agents(scene: Any, is_changing: bool) -> bool:
    """Update the agents' neighbors; whether one of them has a new phase.

    ``is_changing``: whether it enters that phase. Then all are visited from the front of the road
    to its rear, so that a gap that one agent accepts is taken for the next.
    """
    road, vehicles, order, agents = scene.road, scene.vehicles, scene.order, scene.agents
    first, stride = (0, 1) if is_changing else (member(), team_size())
    is_new = False
    rank, unseen = first - stride, road.num_live
    while unseen > 0 and rank + stride < road.num_vehicles:
        rank += stride
        car = vehicles[order[rank]]
        if car.agent == NONE:
            continue
        unseen -= 1
        agent = agents[car.agent]
        find_agent_neighbors(agent, rank, order, road.num_vehicles, vehicles, agents)
        turning = car.yaw_rate - road_turn_rate(car, scene.arcs)
        phase = next_phase(agent, vehicles, turning, scene.profiles, scene.constants)
        if phase != agent.phase:
            is_new = True
            if is_changing:
                enter_phase(agent, phase)
    return is_new


@internal
def _change_phases(scene: Any) -> None:
    """Enter new phases, and leave every agent with the neighbors that it has then."""
    # A team first looks whether there is a new phase: that is rare, and only then is there an
    # order. Then phases change, and at last all get the neighbors of that state.
    look, change, update = 0, 1, 2
    for part in range(look if is_team() else change, update + 1):
        is_changing = part == change
        is_new = False
        if not is_changing or member() == 0:
            is_new = _visit_agents(scene, is_changing)
        if not any_member(is_new):
            break


@internal
def _is_nearest_changer(rank: int, car: Any, order: Any, vehicles: Any, agents: Any) -> bool:
    """Whether no other engaged agent is nearer to the follower of the car's.

    Of two at the same position it is the one that comes first in the order.
    """
    own = agents[car.agent]
    for index in range(agents.shape[0]):
        agent = agents[index]
        if agent.phase != _ENGAGED or agent.target_follower != own.target_follower:
            continue
        position = vehicles[agent.vehicle].position
        if position < car.position:
            return False
        if position == car.position and find_rank(agent.vehicle, order) < rank:
            return False
    return True


@internal
def renew(scene: Any, observations: Any, features: Any) -> None:
    """Update neighbors, phase and observation of every live agent, and its follower.

    Phases change in the order of the vehicles. The rest uses the state after all changes, so the
    order of the agent slots has no influence.
    """
    road, vehicles, order, agents = scene.road, scene.vehicles, scene.order, scene.agents
    _change_phases(scene)
    rank, unseen = member() - team_size(), road.num_live
    while unseen > 0 and rank + team_size() < road.num_vehicles:
        rank += team_size()
        car = vehicles[order[rank]]
        if car.agent == NONE:
            continue
        unseen -= 1
        index = car.agent
        agent = agents[index]
        observe_changer(features, observations[index], agent, car, scene)
        follower = agent.target_follower
        if (
            agent.phase == _ENGAGED
            and follower > NONE
            and _is_nearest_changer(rank, car, order, vehicles, agents)
        ):
            vehicles[follower].changer = agent.vehicle
