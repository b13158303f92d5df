"""Times, counters and random numbers far into an episode."""

import math
from fractions import Fraction

import pytest
from comparing import EVERY_FEATURE
from drawn_scenarios import Drawn
from oracle import follow
from reference.road import Road
from staging import assert_conserved

from marl_lanes.traffic.simulator import Simulator

ENDLESS = {"num_agents": None, "horizon": None, "observation": EVERY_FEATURE}


@pytest.mark.parametrize(
    ("step", "random_counter"), [(10**6, 2**32 - 5), (10**9, 2**53 - 5), (10**9, 2**63 - 5)]
)
def test_late_steps_are_those_of_the_reference(step, random_counter):
    case = Drawn({"departures": {"interval": [0.5, 1.5]}}, seed=3, noise=0.1)
    simulator = case.simulator()
    road, agents = simulator.roads, simulator.agents
    shift = step - int(road["step"][0])
    road["step"] += shift
    road["random_counter"] = random_counter
    agents["born_step"] += shift
    simulator.state.lanes["next_departure"] += shift * simulator.scenario.time_step
    met = follow(case, simulator, Road.of(simulator), 80)
    assert road["step"][0] == step + 80
    assert road["random_counter"][0] > random_counter + 20
    assert met["ENGAGED"] > 0


@pytest.mark.long
def test_a_million_steps_of_one_road():
    simulator = Simulator("dense", seed=7, overrides=ENDLESS)
    simulator.reset()
    road, lanes = simulator.roads, simulator.state.lanes
    start, drawn = int(road["random_counter"][0]), int(road["num_entered"][0])
    lowest, highest = simulator.scenario.departures.interval
    for count in range(1, 10**6 + 1):
        simulator.advance()
        if count % 10_000 == 0:
            assert_conserved(simulator)
            now = count * simulator.scenario.time_step
            assert abs(now - Fraction(count, 10)) < 1e-10
            assert (lanes["next_departure"] - now <= highest).all()
            assert (simulator.vehicles["position"] < simulator.scenario.road.length + 10.0).all()
    assert road["step"][0] == 10**6
    # Six numbers for each vehicle that enters, and one or two for each that may be commanded.
    entered = int(road["num_entered"][0]) - drawn
    assert 6 * entered < int(road["random_counter"][0]) - start < 8 * entered
    # In 100,000 s about one vehicle in each mean interval and lane, if they need not wait.
    assert entered <= math.ceil(10**5 / lowest) * simulator.scenario.road.num_lanes
    assert entered > 0.5 * 10**5 / highest * simulator.scenario.road.num_lanes
    follow(Drawn(), simulator, Road.of(simulator), 100)
