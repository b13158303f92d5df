"""Comparison of the kernel's arrays with a road of the reference, and what happened on it."""

import math

from reference.records import FOLLOWER_TERMS, SCRIPTED
from staging import rows_of

from marl_lanes.scenario import load_scenario
from marl_lanes.traffic.machine.state import Outcome, Phase
from marl_lanes.traffic.roles.changer import CHANGER
from marl_lanes.traffic.roles.external import FOLLOWER_COLUMNS
from marl_lanes.traffic.roles.follower import FOLLOWER

EVERY_FEATURE = {"features": [feature.name for feature in CHANGER.features]}
OBSERVANT = load_scenario("paper", {"observation": EVERY_FEATURE})
FOLLOWER_LOW, FOLLOWER_HIGH = FOLLOWER.observation_bounds(OBSERVANT)


def close(value, expected, tolerance=1e-9):
    return math.isclose(value, expected, rel_tol=tolerance, abs_tol=tolerance)


def compare_vehicles(road, simulator, env):
    count = int(simulator.roads[env]["num_vehicles"])
    slots = simulator.state.order[env, :count].tolist()
    assert slots == [car.slot for car in road.cars]
    names = list(simulator.scenario.drivers.profiles)
    rows = rows_of(simulator.vehicles[env])
    floats = [name for name, (kind, *_) in simulator.vehicles.dtype.fields.items() if kind == "f8"]
    for car in road.cars:
        row = rows[car.slot]
        for name in floats:
            assert close(row[name], getattr(car, name)), (name, car)
        lanes = road.lanes_of(car)
        agent = car.agent.slot if car.agent else -1
        changer = car.changer.slot if car.changer else -1
        expected = car.id, car.lane, lanes[0], lanes[-1], car.disposition, agent, changer
        fields = "id", "lane", "lane_low", "lane_high", "disposition", "agent", "changer"
        assert row["moving_over"] == car.moving_over
        assert tuple(int(row[name]) for name in fields) == expected
        assert names[row["profile"]] == car.profile
    assert sum(simulator.vehicles[env]["id"] >= 0) == count


def compare_agents(road, simulator, env):
    columns = CHANGER.seen(simulator.scenario)
    low, high = CHANGER.observation_bounds(simulator.scenario)
    for slot, row in enumerate(rows_of(simulator.agents[env])):
        agent = road.agents.get(slot)
        seen = simulator.state.observations[env, slot]
        if agent is None:
            assert row["phase"] == Phase.ABSENT
            assert row["outcome"] == Outcome.UNFINISHED
            assert row["vehicle"] == -1
            assert row["reward"] == 0.0
            assert not seen.any()
            continue
        assert row["outcome"] == agent.outcome
        has_ended = agent.outcome != Outcome.UNFINISHED
        assert row["phase"] == (Phase.ABSENT if has_ended else agent.phase)
        fields = "command", "direction", "origin_lane", "target_lane", "born_step"
        expected = agent.command, agent.direction, agent.origin, agent.target, agent.born
        assert tuple(int(row[name]) for name in fields) == expected
        assert row["num_aborts"] == agent.num_aborts
        assert row["steering_steps"] == agent.steering_steps
        paid = CHANGER.terms_of(row)
        for term, value in agent.terms.items():
            assert close(paid[f"reward_{term}"], value), term
        assert close(row["reward"], agent.reward)
        assert close(row["episode_reward"], agent.episode_reward)
        assert close(row["car_following"], agent.car_following)
        for name, other in agent.neighbors.items():
            assert row[name] == (other.slot if other else -1), name
        assert (seen >= low).all()
        assert (seen <= high).all()
        for feature, value in zip(columns, seen, strict=True):
            assert close(value, agent.observation[feature.name], 1e-6), feature.name


def compare_followers(road, simulator, env):
    for slot, row in enumerate(rows_of(simulator.state.followers[env])):
        follower = road.followers.get(slot) if road.external_names else None
        seen = simulator.state.follower_observations[env, slot]
        terms = row["terms"]
        if follower is None:
            assert (row["vehicle"], row["policy"]) == (-1, -1)
            assert not any(terms)
            assert (row["reward"], row["episode_reward"]) == (0.0, 0.0)
            assert not seen.any()
            continue
        driver = follower.car
        assert row["vehicle"] == (-1 if driver is None else driver.slot)
        assert row["policy"] == (-1 if driver is None else driver.disposition - len(SCRIPTED))
        for term, value in zip(FOLLOWER_TERMS, terms, strict=True):
            assert close(value, follower.terms[term]), term
        assert close(row["reward"], follower.reward)
        assert close(row["episode_reward"], follower.episode_reward)
        assert (seen >= FOLLOWER_LOW).all()
        assert (seen <= FOLLOWER_HIGH).all()
        for name, value, expected in zip(FOLLOWER_COLUMNS, seen, follower.observation, strict=True):
            assert close(value, expected, 1e-6), name


def met_by_agents(road):
    """Phases and outcomes of the agents, by name: members of different enumerations are equal."""
    for agent in road.agents.values():
        yield agent.phase.name
        yield agent.outcome.name


def met_behind(road):
    """What occurred to the drivers behind the changers."""
    for slot, follower in road.followers.items():
        yield "unpaired" if follower.car is None else "paired"
        yield from (term for term, value in follower.terms.items() if value)
        driver = road.agents[slot].neighbors["target_follower"]
        if driver is not None and driver.changer and driver.disposition < len(SCRIPTED):
            yield "scripted"


def moving_over(road):
    """The lanes of the vehicles that move over, by id."""
    return {car.id: car.lane for car in road.cars if car.moving_over}


def met_beside(road, moving):
    """What occurred to the vehicles that move over, or did before the step."""
    for car in road.cars:
        if car.moving_over:
            yield "moving over"
        elif car.id in moving:
            yield "moved over" if moving[car.id] == car.lane else "took back"


def compare_road(road, simulator, env):
    record = simulator.roads[env]
    assert {name: int(record[name]) for name in road.counts} == road.counts
    assert record["random_counter"] == road.random.count
    names = list(simulator.scenario.drivers.profiles)
    for lane, expected in zip(simulator.state.lanes[env], road.departures, strict=True):
        assert close(lane["next_departure"], expected[0])
        assert close(lane["next_speed"], expected[1])
        assert names[lane["next_profile"]] == expected[2]
    records = simulator.state.collisions[env]
    for back, expected in enumerate(reversed(road.collisions[-len(records) :])):
        row = records[(road.counts["num_collisions"] - 1 - back) % len(records)]
        for name, value in expected.items():
            assert close(row[name], value), name
