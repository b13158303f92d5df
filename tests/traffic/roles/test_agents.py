"""Two agents before one driver: whom it follows, and who gets a gap that both could take."""

import pytest
from external_followers import OPEN_GAP
from staging import command, simulator_of, stage

from marl_lanes.traffic.machine.state import Phase

RIGHT, LEFT = 1, 2
"""Slots of the changers; the driver behind them has slot 0."""


def step_with_two(driver, right, left, *, first, phase):
    """A step on five lanes; the agents' slots of RIGHT and LEFT, of which ``first`` has slot 0."""
    simulator = simulator_of(road={"num_lanes": 5}, gap=OPEN_GAP)
    stage(simulator, {"position": 60.0, **driver}, right, left)
    slots = {}
    for vehicle in (first, RIGHT + LEFT - first):
        slots[vehicle] = command(simulator, vehicle, 1 if vehicle == RIGHT else -1, phase)
    simulator.step()
    return simulator, slots


@pytest.mark.parametrize("first", [RIGHT, LEFT])
@pytest.mark.parametrize(
    ("positions", "nearest"),
    [((100.0, 120.0), RIGHT), ((120.0, 100.0), LEFT), ((110.0, 110.0), RIGHT)],
)
def test_a_driver_in_two_lanes_follows_the_nearest_changer(positions, nearest, first):
    """Of two at the same position the first one in the order, whichever slot its agent has."""
    simulator, slots = step_with_two(
        {"lane": 1, "lateral_position": 7.5},
        {"lane": 0, "position": positions[0]},
        {"lane": 3, "position": positions[1]},
        first=first,
        phase=Phase.ENGAGED,
    )
    agents = simulator.agents[0][[slots[RIGHT], slots[LEFT]]]
    assert agents["phase"].tolist() == [Phase.ENGAGED] * 2
    assert agents["target_lane"].tolist() == [1, 2]
    assert agents["target_follower"].tolist() == [0, 0]
    assert simulator.vehicles["changer"][0, 0] == nearest


@pytest.mark.parametrize("first", [RIGHT, LEFT])
def test_the_one_ahead_takes_the_gap(first):
    simulator, slots = step_with_two(
        {"lane": 1},
        {"lane": 0, "position": 100.0},
        {"lane": 2, "position": 101.0},
        first=first,
        phase=Phase.WAITING,
    )
    right, left = simulator.agents[0][[slots[RIGHT], slots[LEFT]]]
    assert left["phase"] == Phase.ENGAGED
    assert right["phase"] == Phase.WAITING
    assert right["target_leader"] == LEFT
    # It knows whom the other one's phase has put behind it.
    assert left["target_follower"] == 0
    assert simulator.vehicles["changer"][0, 0] == LEFT
