"""Traffic that tests place by hand, a simple steering policy, and what every traffic keeps."""

import math

import numpy as np
from reference.records import Car
from reference.road import Road

from marl_lanes.traffic.machine.state import Disposition, Outcome, Phase
from marl_lanes.traffic.road.geometry import road_turn_rate
from marl_lanes.traffic.road.lane_keeping import keep_lane
from marl_lanes.traffic.road.motion import integrate
from marl_lanes.traffic.simulator import Simulator

TRUCK = 3
"""Row of the profile ``truck``: 16.5 m by 2.55 m, beside cars of 4.8 m by 1.8 m."""

MIXED = {"drivers": {"mix": {"normal": 0.5, "truck": 0.5}}}
"""Overrides with cars and trucks."""


def damped_actions(simulator, noise=0.0, generator=None):
    """(E, A, D) actions that complete the changes, roughly; with noise if there is a generator.

    The second action is the last step's car following, or with a generator a random one.
    """
    actions = np.zeros((*simulator.agents.shape, simulator.num_actions))
    if simulator.num_actions == 2:
        actions[..., 1] = simulator.agents["car_following"]
        if generator is not None:
            actions[..., 1] = generator.uniform(-4.0, 4.0, simulator.agents.shape)
    rows = simulator.is_steering
    agents = simulator.agents[rows]
    cars = simulator.vehicles[rows.nonzero()[0], agents["vehicle"]]
    is_back = agents["phase"] == Phase.ABORTING
    lanes = np.where(is_back, agents["origin_lane"], agents["target_lane"])
    error = (lanes + 0.5) * simulator.scenario.road.lane_width - cars["lateral_position"]
    steering = error / np.maximum(cars["speed"], 1.0) - 3.0 * (cars["yaw"] + cars["yaw_rate"])
    if generator is not None:
        steering += noise * generator.uniform(-1.0, 1.0, steering.shape)
    actions[rows, 0] = agents["direction"] * steering
    return actions


def rows_of(table):
    """The rows of a table as dictionaries of plain values, which are quick to read and compare."""
    names = table.dtype.names
    columns = [table[name].tolist() for name in names]
    return [dict(zip(names, row, strict=True)) for row in zip(*columns, strict=True)]


def simulator_of(**overrides):
    """A simulator of the paper's scenario with an empty road."""
    simulator = Simulator("paper", overrides={"warmup": [0.0, 0.0], **overrides}, seed=0)
    simulator.reset()
    return simulator


def stage(simulator, *cars, env=0):
    """Empty a road and place these cars, each a dict of fields, in slots 0, 1, ...

    There are no more departures. By default a car is in the centre of its lane with yaw 0.
    """
    vehicles, state = simulator.vehicles[env], simulator.state
    vehicles["id"] = vehicles["agent"] = vehicles["changer"] = -1
    vehicles["fate"] = simulator.roads["num_removed"][env] = 0
    simulator.agents[env]["vehicle"] = -1
    simulator.agents[env]["phase"] = Phase.ABSENT
    simulator.agents[env]["outcome"] = Outcome.UNFINISHED
    state.followers[env]["vehicle"] = state.followers[env]["policy"] = -1
    state.lanes[env]["next_departure"] = math.inf
    road = simulator.roads[env : env + 1]
    for slot, fields in enumerate(cars):
        row = vehicles[slot]
        for name in row.dtype.names:
            row[name] = {"id": int(road["num_entered"][0]), "agent": -1, "changer": -1}.get(name, 0)
        row["speed"], row["desired_speed"], row["command_position"] = 20.0, 30.0, math.inf
        row["lateral_position"] = 3.75 * (fields["lane"] + 0.5)
        row["disposition"] = Disposition.NEUTRAL
        for name, value in fields.items():
            row[name] = value
        lanes = Road(simulator.scenario).lanes_of(pose_of(simulator, row, slot))
        row["lane_low"], row["lane_high"] = lanes[0], lanes[-1]
        road["num_entered"] += 1
    positions = vehicles["position"][: len(cars)]
    state.order[env, : len(cars)] = sorted(range(len(cars)), key=lambda slot: -positions[slot])
    road["num_live"], road["num_vehicles"] = 0, len(cars)
    road["num_left"] = road["num_entered"] - len(cars) - road["num_collided"]


def pose_of(simulator, row, slot=0):
    """A vehicle as the reference has it."""
    fields = {name: row[name] for name in Car.__annotations__ if name in row.dtype.names}
    names = list(simulator.scenario.drivers.profiles)
    return Car(**fields | {"slot": slot, "profile": names[row["profile"]]})


def command(simulator, vehicle, direction, phase=Phase.ENGAGED, *, env=0):
    """Give a command to the car in a slot; returns the agent's slot."""
    slot = int(simulator.agents[env]["vehicle"].tolist().index(-1))
    row, road = simulator.agents[env, slot], simulator.roads[env : env + 1]
    lane = int(simulator.vehicles[env, vehicle]["lane"])
    row["vehicle"], row["direction"], row["phase"] = vehicle, direction, phase
    row["origin_lane"], row["target_lane"] = lane, lane + direction
    row["command"], row["born_step"] = road["num_commands"][0], road["step"][0]
    row["leader"] = row["follower"] = row["target_leader"] = row["target_follower"] = -1
    row["num_aborts"] = row["steering_steps"] = row["episode_reward"] = 0
    simulator.vehicles[env, vehicle]["agent"] = slot
    road["num_live"] += 1
    road["num_commands"] += 1
    return slot


def one_arc(radius, **overrides):
    """A simulator of a road that is one arc of 900 m."""
    arcs = [{"start": 0.0, "end": 900.0, "radius": radius, "transition": 0.0}]
    return Simulator("paper", overrides={"road": {"arcs": arcs}, **overrides}, seed=0)


def place(simulator, **values):
    """A simulator's first vehicle, set to the centre of lane 0 at 20 m/s, except ``values``."""
    car = simulator.vehicles[0, 0]
    for name in ("position", "acceleration", "yaw", "yaw_rate", "yaw_acceleration", "lane"):
        car[name] = 0
    car["lateral_position"], car["speed"] = 1.875, 20.0
    for name, value in values.items():
        car[name] = value
    return car


def advance(simulator, car, *, is_keeping=True):
    """One step of one car alone, steered by lane keeping or by its yaw acceleration."""
    arcs, constants = simulator.parameters.arcs, simulator.parameters.constants[0]
    profiles = simulator.parameters.profiles
    turn_rate = road_turn_rate(car, arcs)
    if is_keeping:
        car["yaw_acceleration"] = keep_lane(car, turn_rate, constants)
    integrate(car, turn_rate, profiles, arcs, constants)


def present(simulator):
    """(E, V): slots that hold a vehicle."""
    return simulator.vehicles["id"] >= 0


def assert_conserved(simulator):
    """Assert that no vehicle is lost or made, and that the order has each one once."""
    roads = simulator.roads
    gone = roads["num_left"] + roads["num_collided"]
    assert (roads["num_entered"] == roads["num_vehicles"] + gone).all()
    assert (present(simulator).sum(axis=1) == roads["num_vehicles"]).all()
    assert (roads["num_off_road"] <= roads["num_left"]).all()
    for env, count in enumerate(roads["num_vehicles"].tolist()):
        order = simulator.state.order[env, :count]
        assert len(set(order.tolist())) == count
        assert (simulator.vehicles[env, order]["id"] >= 0).all()
        assert (np.diff(simulator.vehicles[env, order]["position"]) <= 0.0).all()
