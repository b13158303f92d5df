"""The one kernel of a time step, which also resets masked roads.

Every array argument is one road's row of the state, or a parameter of the scenario. Only the entry
point ``run`` takes whole arrays and a range of roads, so that threads can share a batch.
"""

import math
from typing import Any

from marl_lanes.traffic.command.phases import (
    clear_agent,
    clear_ended,
    give_commands,
    is_steering,
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
from marl_lanes.traffic.machine.prefetch import prefetch
from marl_lanes.traffic.machine.state import NONE, Outcome
from marl_lanes.traffic.machine.team import (
    any_member,
    is_team,
    least,
    meet,
    member,
    most,
    team_size,
)
from marl_lanes.traffic.road.geometry import is_off_road, road_turn_rate
from marl_lanes.traffic.road.lane_keeping import keep_lane
from marl_lanes.traffic.road.motion import integrate
from marl_lanes.traffic.road.neighbors import insert_by_position
from marl_lanes.traffic.roles.agents import judge, renew
from marl_lanes.traffic.roles.changer import Scene
from marl_lanes.traffic.roles.pairing import clear_follower, pair

STEP = 0
SKIP = 1
WARM_UP = 2
RESET = 3
"""What ``run`` does with a road."""

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
        relative motion of two vehicles along the road and across it [m]; a team says 0 where
        collisions do not depend on it.
    """
    is_leaving = is_command_due = False
    furthest, nearest, left, right = -math.inf, math.inf, 0.0, 0.0
    bound = constants.max_yaw_acceleration
    for rank in range(member(), road.num_vehicles, team_size()):
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
        if not is_team():
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
    along, across = furthest - nearest, left - right
    if is_team():
        meet()
        if any_member(_has_overtaken(road, order, vehicles)) and member() == 0:
            for rank in range(1, road.num_vehicles):
                insert_by_position(order, rank, vehicles)
        # Mostly no vehicle is so fast that two could pass each other within the step.
        is_slow = nearest >= 0.0 and furthest <= constants.shortest_length
        is_straight = max(left, -right) <= 0.25 * constants.narrowest_width
        along = across = 0.0
        if any_member(not (is_slow and is_straight)):
            along, across = most(furthest) - least(nearest), most(left) - least(right)
    return any_member(is_leaving), any_member(is_command_due), along, across


@internal
def _has_overtaken(road: Any, order: Any, vehicles: Any) -> bool:
    """Whether one of the member's vehicles is ahead of the one before it in the order."""
    for rank in range(member() + 1, road.num_vehicles, team_size()):
        if vehicles[order[rank - 1]].position < vehicles[order[rank]].position:
            return True
    return False


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


@internal
def advance(
    scene: Any,
    lanes: Any,
    followers: Any,
    collisions: Any,
    actions: Any,
    follower_actions: Any,
    observations: Any,
    follower_observations: Any,
    dispositions: Any,
    features: Any,
    follower_features: Any,
    every_vehicle: Any,
    after: int,
) -> None:
    """A time step of a road: move over, drive, move, judge, remove, depart, command, renew, pair.

    ``every_vehicle`` and ``after`` are those of ``accelerate``.
    """
    road, vehicles, order, agents = scene.road, scene.vehicles, scene.order, scene.agents
    profiles, arcs, p = scene.profiles, scene.arcs, scene.constants
    if member() == 0:
        clear_ended(road, agents, observations)
        free_slots(road, vehicles)
        if p.is_moving_over_allowed:
            move_over(road, order, vehicles, agents, profiles, arcs, p)
    meet()
    accelerate(
        road,
        lanes,
        vehicles,
        order,
        agents,
        followers,
        actions,
        follower_actions,
        profiles,
        arcs,
        p,
        every_vehicle,
        after,
    )
    meet()
    is_leaving, is_command_due, along, across = move(
        road, vehicles, order, agents, actions, profiles, arcs, p
    )
    if member() == 0:
        road.step += 1
    meet()
    if detect_collisions(road, along, across, vehicles, order, agents, collisions, profiles, p):
        is_leaving = True
    if road.num_live > 0:
        judge(scene, observations, features)
    meet()
    if member() == 0:
        if is_leaving:
            remove_vehicles(road, vehicles, order)
        depart(road, lanes, vehicles, order, agents, p, profiles, dispositions, arcs)
        # A vehicle may enter at its command position.
        if is_command_due or p.command_low == 0.0:
            give_commands(road, vehicles, order, agents, p)
    meet()
    if road.num_live > 0:
        renew(scene, observations, features)
    meet()
    if p.num_external > 0:
        pair(scene, followers, follower_observations, follower_features)
    meet()
    if member() == 0:
        end_episode(road, agents, p)
    meet()


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

    It is one function with one entry point, because the compiler optimises all called functions
    again at each level of calls. All members of a road's team call it with the same arguments.

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
            if member() == 0:
                clear(road, lane, cars, live, behind, crashes, seen, seen_behind, profiles, p)
            meet()
        for _ in range(num_steps):
            if mode == SKIP and (road.num_live > 0 or road.is_done):
                break
            if mode == WARM_UP and road.step >= 0:
                break
            advance(
                scene,
                lane,
                behind,
                crashes,
                actions[env],
                follower_actions[env],
                seen,
                seen_behind,
                dispositions,
                features,
                follower_features,
                vehicles,
                after,
            )
