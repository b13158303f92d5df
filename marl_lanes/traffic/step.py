"""The one kernel of a time step, which also resets masked roads.

Every array argument is one road's row of the state, or a parameter of the scenario. Only the entry
point ``run`` takes whole arrays and a range of roads, so that threads can share a batch.
"""

import math
from typing import Any

from marl_lanes.traffic.command.outcome import find_outcome
from marl_lanes.traffic.command.phases import (
    change_phase,
    clear_agent,
    clear_ended,
    end_commands,
    give_commands,
    is_steering,
    lateral_deviation,
)
from marl_lanes.traffic.driving.acceleration import accelerate
from marl_lanes.traffic.driving.yielding import move_over
from marl_lanes.traffic.flow.collisions import (
    LEAVES,
    STRAYS,
    detect_collisions,
    free_slots,
    remove_vehicles,
)
from marl_lanes.traffic.flow.departures import clear_road, depart
from marl_lanes.traffic.machine.compiled import compiled, internal
from marl_lanes.traffic.machine.convergence import converge
from marl_lanes.traffic.machine.prefetch import prefetch
from marl_lanes.traffic.machine.state import NONE, Outcome, Phase
from marl_lanes.traffic.road.geometry import is_off_road, road_turn_rate
from marl_lanes.traffic.road.lane_keeping import keep_lane
from marl_lanes.traffic.road.motion import integrate
from marl_lanes.traffic.road.neighbors import find_agent_neighbors, find_rank, insert_by_position
from marl_lanes.traffic.roles.changer import Scene, Step, observe_changer, pay_changer
from marl_lanes.traffic.roles.pairing import clear_follower, pair

STEP = 0
SKIP = 1
WARM_UP = 2
RESET = 3
"""What ``run`` does with a road."""

_ABSENT = int(Phase.ABSENT)
_ENGAGED = int(Phase.ENGAGED)
_UNFINISHED = int(Outcome.UNFINISHED)
_COMPLETED = int(Outcome.COMPLETED)
_COLLISION = int(Outcome.COLLISION)
_OFF_ROAD = int(Outcome.OFF_ROAD)
_MISSED = int(Outcome.MISSED)
_HORIZON = int(Outcome.HORIZON)


@internal
def move(
    road: Any,
    vehicles: Any,
    order: Any,
    agents: Any,
    actions: Any,
    profiles: Any,
    arcs: Any,
    constants: Any,
) -> tuple[bool, bool, float, float]:
    """Steer and move every vehicle, update the order, mark the vehicles that leave the road.

    Returns:
        Whether a vehicle leaves, whether one has reached its command position, and the longest
        relative motion of two vehicles along the road and across it [m].
    """
    is_leaving = is_command_due = False
    furthest, nearest, left, right = -math.inf, math.inf, 0.0, 0.0
    bound = constants.max_yaw_acceleration
    for rank in range(road.num_vehicles):
        car = vehicles[order[rank]]
        turn_rate = road_turn_rate(car, arcs)
        if car.agent > NONE and is_steering(agents[car.agent]):
            action = min(max(actions[car.agent, 0], -bound), bound)
            car.yaw_acceleration = agents[car.agent].direction * action
        else:
            car.yaw_acceleration = keep_lane(car, turn_rate, constants)
        before = car.lateral_position
        extent = integrate(car, turn_rate, profiles, arcs, constants)
        furthest, nearest = max(furthest, car.advance), min(nearest, car.advance)
        sideways = car.lateral_position - before
        left, right = max(left, sideways), min(right, sideways)
        insert_by_position(order, rank, vehicles)
        car.changer = NONE
        if is_off_road(car, extent, constants):
            car.fate = STRAYS
            is_leaving = True
        elif car.position >= constants.road_length:
            car.fate = LEAVES
            is_leaving = True
        elif car.position >= car.command_position:
            is_command_due = True
    return is_leaving, is_command_due, furthest - nearest, left - right


@internal
def judge(scene: Any, observations: Any, features: Any) -> None:
    """Set the reward of every live agent for the step, and end the commands that are over."""
    road, vehicles, order, agents = scene.road, scene.vehicles, scene.order, scene.agents
    arcs, constants = scene.arcs, scene.constants
    has_ended = False
    index, unseen = -1, road.num_live
    while unseen > 0:
        converge()
        index += 1
        while agents[index].phase == _ABSENT:
            index += 1
        agent = agents[index]
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
    if has_ended:
        # After all observations: until it ends, an engaged agent counts as in its target lane.
        end_commands(road, vehicles, agents, scene.profiles, constants)


@internal
def renew(scene: Any, observations: Any, features: Any) -> None:
    """Update neighbors, phase and observation of every live agent, and its follower.

    Phases change from the front of the road to its rear, so a gap that one agent accepts is taken
    for the next. The rest uses the state after all changes, so the order of the agent slots has no
    influence.
    """
    road, vehicles, order, agents = scene.road, scene.vehicles, scene.order, scene.agents
    has_changed = False
    rank, unseen = -1, road.num_live
    while unseen > 0:
        converge()
        rank += 1
        while vehicles[order[rank]].agent == NONE:
            rank += 1
        car = vehicles[order[rank]]
        unseen -= 1
        agent = agents[car.agent]
        find_agent_neighbors(agent, rank, order, road.num_vehicles, vehicles, agents)
        phase = agent.phase
        turning = car.yaw_rate - road_turn_rate(car, scene.arcs)
        change_phase(agent, vehicles, turning, scene.profiles, scene.constants)
        has_changed = has_changed or agent.phase != phase
    rank, unseen = -1, road.num_live
    while unseen > 0:
        converge()
        rank += 1
        while vehicles[order[rank]].agent == NONE:
            rank += 1
        car = vehicles[order[rank]]
        unseen -= 1
        index = car.agent
        agent = agents[index]
        if has_changed:
            find_agent_neighbors(agent, rank, order, road.num_vehicles, vehicles, agents)
        observe_changer(features, observations[index], agent, car, scene)
        follower = agent.target_follower
        if agent.phase == _ENGAGED and follower > NONE:
            nearest = vehicles[follower].changer
            if nearest == NONE or car.position < vehicles[nearest].position:
                vehicles[follower].changer = agent.vehicle


@internal
def end_episode(road: Any, agents: Any, constants: Any) -> None:
    """Record the end of the episode: all commands have ended, or the horizon is reached."""
    is_last_over = road.num_commands == constants.num_agents > 0 and road.num_live == 0
    if road.step == constants.horizon_steps > 0:
        has_cut = not is_last_over
        for index in range(agents.shape[0]):
            has_cut = has_cut or agents[index].outcome == _HORIZON
        road.is_done = 1
        road.is_cut = 1 if has_cut else 0
    elif is_last_over:
        road.is_done = 1


@internal
def clear(
    road: Any,
    lanes: Any,
    vehicles: Any,
    agents: Any,
    followers: Any,
    collisions: Any,
    observations: Any,
    follower_observations: Any,
    profiles: Any,
    constants: Any,
) -> None:
    """Empty one road and begin its warm-up."""
    clear_road(road, lanes, vehicles, profiles, constants)
    for index in range(agents.shape[0]):
        clear_agent(agents[index])
        agents[index].command = NONE
        clear_follower(followers[index])
    for newest in range(collisions.shape[0]):
        collisions[newest].rear_id = collisions[newest].front_id = NONE
    observations[:] = 0.0
    follower_observations[:] = 0.0


@compiled
def run(
    start: int,
    stop: int,
    mode: int,
    num_steps: int,
    mask: Any,
    actions: Any,
    follower_actions: Any,
    roads: Any,
    lanes: Any,
    vehicles: Any,
    order: Any,
    agents: Any,
    followers: Any,
    collisions: Any,
    observations: Any,
    follower_observations: Any,
    constants: Any,
    profiles: Any,
    dispositions: Any,
    arcs: Any,
    features: Any,
    follower_features: Any,
) -> None:
    """Advance the masked roads from ``start`` to ``stop``; the others keep every byte.

    A time step: move over, drive, move, judge, remove, depart, command, renew, pair. It is one
    function with one entry point, because the compiler optimises all called functions again at each
    level of calls.

    Args:
        start: first road.
        stop: the road after the last.
        mode: STEP; SKIP until an agent is live or the episode is over; WARM_UP until the warm-up is
            over; RESET to empty the road first.
        num_steps: the most time steps of each road.
        mask: (E,) bool.
        actions: (E, A, D) float64, yaw acceleration in the maneuver frame [rad/s^2] and, if the
            scenario has it, longitudinal acceleration [m/s^2].
        follower_actions: (E, A, 1) float64, longitudinal acceleration of the external driver paired
            with the changer in that slot [m/s^2].
        roads: this and the next arguments are the arrays of State, then those of Parameters.
    """
    p = constants[0]
    for env in range(start, stop):
        if not mask[env]:
            continue
        # Roads are alike: the next one has about as many vehicles and agents as this one.
        after = min(env + 1, stop - 1)
        prefetch(roads, after, 0, roads.itemsize)
        prefetch(lanes, after, 0, lanes[env].nbytes)
        prefetch(order, after, 0, order.itemsize * roads[env].num_vehicles)
        prefetch(agents, after, 0, agents.itemsize * roads[env].num_live)
        road, lane, cars, ranks = roads[env], lanes[env], vehicles[env], order[env]
        live, seen, crashes = agents[env], observations[env], collisions[env]
        behind, seen_behind = followers[env], follower_observations[env]
        scene = Scene(road, cars, ranks, live, profiles, arcs, p)
        if mode == RESET:
            clear(road, lane, cars, live, behind, crashes, seen, seen_behind, profiles, p)
        for _ in range(num_steps):
            if mode == SKIP and (road.num_live > 0 or road.is_done):
                break
            if mode == WARM_UP and road.step >= 0:
                break
            clear_ended(road, live, seen)
            free_slots(road, cars)
            if p.is_moving_over_allowed:
                move_over(road, ranks, cars, live, profiles, arcs, p)
            accelerate(
                road,
                lane,
                cars,
                ranks,
                live,
                behind,
                actions[env],
                follower_actions[env],
                profiles,
                arcs,
                p,
                vehicles,
                after,
            )
            is_leaving, is_command_due, along, across = move(
                road, cars, ranks, live, actions[env], profiles, arcs, p
            )
            road.step += 1
            if detect_collisions(road, along, across, cars, ranks, live, crashes, profiles, p):
                is_leaving = True
            if road.num_live > 0:
                judge(scene, seen, features)
            if is_leaving:
                remove_vehicles(road, cars, ranks)
            depart(road, lane, cars, ranks, live, p, profiles, dispositions, arcs)
            # A vehicle may enter at its command position.
            if is_command_due or p.command_low == 0.0:
                give_commands(road, cars, ranks, live, p)
            if road.num_live > 0:
                renew(scene, seen, features)
            if p.num_external > 0:
                pair(scene, behind, seen_behind, follower_features)
            end_episode(road, live, p)
