"""The life of a command: waiting, engaged, aborting, and its end.

waiting: lane keeping steers, the gap rule checks the target lane. engaged: the agent steers
toward the target lane. aborting: the agent steers back to the origin lane, then waits again.
"""

import math
from typing import Any

from marl_lanes.traffic.command.gap import is_target_gap_safe
from marl_lanes.traffic.command.outcome import has_arrived
from marl_lanes.traffic.machine.compiled import compiled, internal
from marl_lanes.traffic.machine.random import uniform
from marl_lanes.traffic.machine.state import NONE, Outcome, Phase
from marl_lanes.traffic.road.geometry import half_extent, is_body_in, lane_centre, lane_under

_ABSENT = int(Phase.ABSENT)
_WAITING = int(Phase.WAITING)
_ENGAGED = int(Phase.ENGAGED)
_ABORTING = int(Phase.ABORTING)
_UNFINISHED = int(Outcome.UNFINISHED)
_COMPLETED = int(Outcome.COMPLETED)
_TIMED_OUT = int(Outcome.TIMED_OUT)


@internal
def is_live(agent: Any) -> bool:
    """Whether the slot has a command that is unfinished."""
    return bool(agent.phase != _ABSENT)


@internal
def is_aborting(agent: Any) -> bool:
    """Whether the agent steers back to its origin lane."""
    return bool(agent.phase == _ABORTING)


@internal
def is_steering(agent: Any) -> bool:
    """Whether the agent steers: engaged or aborting."""
    return bool(agent.phase == _ENGAGED or agent.phase == _ABORTING)


@internal
def is_acting(agent: Any, has_longitudinal: bool) -> bool:
    """Whether its action has an effect: it steers, or it is live and has a second action."""
    return is_steering(agent) or (has_longitudinal and is_live(agent))


@internal
def reference_lane(phase: Any, origin_lane: Any, target_lane: Any) -> Any:
    """The reference lane of an agent: its origin lane while aborting, else its target lane.

    So a waiting agent already observes its deviation from the target lane.
    """
    # Without a branch, so that it also works on columns of a table.
    return target_lane + (origin_lane - target_lane) * (phase == _ABORTING)


@compiled
def lateral_deviation(agent: Any, car: Any, constants: Any) -> float:
    """Distance to the reference lane's centre [m], positive toward the target lane."""
    lane = reference_lane(agent.phase, agent.origin_lane, agent.target_lane)
    distance = lane_centre(lane, constants.lane_width) - car.lateral_position
    return float(agent.direction * distance)


@internal
def choose_direction(road: Any, lane: int, constants: Any) -> int:
    """+1 to the left or -1 to the right, drawn; from an outer lane the only side there is."""
    if lane == 0:
        return 1
    if lane == constants.num_lanes - 1:
        return -1
    return 1 if uniform(road, 0.0, 1.0) < 0.5 else -1


@internal
def give_commands(road: Any, vehicles: Any, order: Any, agents: Any, constants: Any) -> None:
    """Give commands to vehicles in the commanded lanes at their command position, each once.

    If no agent slot is free, the decision waits for one.
    """
    for rank in range(road.num_vehicles):
        slot = order[rank]
        car = vehicles[slot]
        # If a vehicle is moving over, the decision waits until the move ends.
        if car.position < car.command_position or car.moving_over != 0:
            continue
        is_last_step = road.step == constants.horizon_steps > 0
        is_over = road.is_done or is_last_step or road.num_commands == constants.num_agents > 0
        if road.step < 0 or is_over or not (constants.command_lanes >> car.lane) & 1:
            car.command_position = math.inf
            continue
        index = 0
        while index < agents.shape[0] and agents[index].vehicle != NONE:
            index += 1
        if index == agents.shape[0]:
            return
        car.command_position = math.inf
        if uniform(road, 0.0, 1.0) >= constants.command_probability:
            continue
        agent = agents[index]
        agent.direction = choose_direction(road, car.lane, constants)
        agent.vehicle = slot
        agent.command = road.num_commands
        agent.phase = _WAITING
        agent.origin_lane = car.lane
        agent.target_lane = car.lane + agent.direction
        agent.num_aborts = 0
        agent.born_step = road.step
        agent.steering_steps = 0
        agent.episode_reward = 0.0
        car.agent = index
        road.num_commands += 1
        road.num_live += 1


@internal
def next_phase(agent: Any, vehicles: Any, turning: float, profiles: Any, constants: Any) -> int:
    """Its phase after the step, by the gap rule and the vehicle's position.

    It engages, aborts or returns to waiting.
    """
    car = vehicles[agent.vehicle]
    if agent.phase == _WAITING:
        if is_target_gap_safe(agent, vehicles, profiles, constants):
            return _ENGAGED
    elif agent.phase == _ENGAGED:
        is_over_marking = is_body_in(car, agent.target_lane)
        if not is_over_marking and not is_target_gap_safe(agent, vehicles, profiles, constants):
            return _ABORTING
    elif has_arrived(lateral_deviation(agent, car, constants), car, turning, constants):
        return _WAITING
    return int(agent.phase)


@internal
def enter_phase(agent: Any, phase: int) -> None:
    """Set another phase."""
    agent.phase = phase
    if phase == _ABORTING:
        agent.num_aborts += 1


@internal
def lane_to_keep(agent: Any, car: Any, profiles: Any, constants: Any) -> int:
    """The lane that lane keeping steers to once the command's time is over.

    The one that the agent drives to, the target lane while engaged, else its own; or the nearest to
    it that the body is in, or is in within 1/p at its lateral speed, p the pole of lane keeping. So
    nobody goes over a marking for a command that has ended, and who is over it, or cannot stay
    away from it, does not swerve back.
    """
    lane = agent.target_lane if agent.phase == _ENGAGED else agent.origin_lane
    way = car.speed * math.sin(car.yaw) / constants.keeping_pole
    extent = half_extent(car.yaw, profiles[car.profile])
    low = lane_under(car.lateral_position + min(way, 0.0) - extent, constants)
    high = lane_under(car.lateral_position + max(way, 0.0) + extent, constants)
    return int(min(max(lane, low), high))


@internal
def end_commands(road: Any, vehicles: Any, agents: Any, profiles: Any, constants: Any) -> None:
    """End the commands that have an outcome; their slots are free again from the next step on."""
    for index in range(agents.shape[0]):
        agent = agents[index]
        if agent.phase == _ABSENT or agent.outcome == _UNFINISHED:
            continue
        car = vehicles[agent.vehicle]
        if agent.outcome == _COMPLETED:
            car.lane = agent.target_lane
        elif agent.outcome == _TIMED_OUT:
            car.lane = lane_to_keep(agent, car, profiles, constants)
        agent.phase = _ABSENT
        car.agent = NONE
        road.num_live -= 1
        road.num_ended += 1


@internal
def clear_ended(road: Any, agents: Any, observations: Any) -> None:
    """Free the slots of the commands that ended in the step before."""
    if road.num_ended == 0:
        return
    road.num_ended = 0
    for index in range(agents.shape[0]):
        agent = agents[index]
        if agent.outcome != _UNFINISHED:
            clear_agent(agent)
            observations[index, :] = 0.0


@internal
def clear_agent(agent: Any) -> None:
    """Empty an agent slot; the serial number of its last command stays readable."""
    agent.vehicle = NONE
    agent.phase = _ABSENT
    agent.outcome = _UNFINISHED
    agent.leader = agent.follower = NONE
    agent.target_leader = agent.target_follower = NONE
    agent.car_following = 0.0
    clear_payment(agent)


@internal
def clear_payment(record: Any) -> None:
    """Set the reward of an agent or a follower for this step to 0."""
    record.reward = 0.0
    record.terms[:] = 0.0
