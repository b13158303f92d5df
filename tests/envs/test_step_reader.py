"""The dicts that a reader makes of a road: who is in them, and whose arrays it reads."""

import copy
import pickle

import numpy as np
import pytest

from marl_lanes import Simulator
from marl_lanes.envs.step_reader import StepReader
from marl_lanes.traffic.machine.state import Outcome, Phase

BUSY = {
    "num_agents": 30,
    "departures": {"interval": [1.5, 3.0]},
    "command": {"probability": 1.0, "time_limit": 6.0},
}
NAMES = {role: [f"{role}_{k}" for k in range(30)] for role in ("changer", "follower")}


def read(reader):
    dicts = ({}, {}, {}, {}, {})
    return reader.read(dicts), dicts


@pytest.fixture
def road():
    """Several agents are live, and the last step has ended another."""
    simulator = Simulator("dense", seed=0, overrides=BUSY, learned_followers=True)
    simulator.reset()
    while not (simulator.has_ended.any() and simulator.is_live.sum() > 1):
        simulator.step()
    return simulator


def test_who_is_live_and_who_has_just_ended_are_told_of(road):
    reader = StepReader(road, NAMES)
    agents, dicts = read(reader)
    told = {}
    for slot, row in enumerate(road.agents[0]):
        if row["phase"] != Phase.ABSENT or row["outcome"] != Outcome.UNFINISHED:
            told |= {names[row["command"]]: slot for names in NAMES.values()}
    assert all(part.keys() == told.keys() for part in dicts)
    ended = {name for name, slot in told.items() if road.has_ended[0, slot]}
    assert 0 < len(ended) < len(told)
    assert agents == [name for names in NAMES.values() for name in names if name in reader.slots]
    assert reader.slots == {name: slot for name, slot in told.items() if name not in ended}
    observations, rewards, terminations, truncations, infos = dicts
    for name, slot in told.items():
        row = (road.state.followers if name in NAMES["follower"] else road.agents)[0, slot]
        assert rewards[name] == row["reward"]
        assert (terminations[name] or truncations[name]) == (name in ended)
        assert infos[name]["phase"] == road.agents[0, slot]["phase"]
    for name in set(told) & set(NAMES["changer"]):
        assert np.array_equal(observations[name], road.state.observations[0, told[name]])


def test_what_is_in_the_dicts_stays_or_is_replaced(road):
    reader = StepReader(road, NAMES)
    _, dicts = read(reader)
    seen = {name: one.copy() for name, one in dicts[0].items()}
    road.step()
    reader.read(dicts)
    _, alone = read(reader)
    assert dicts[0].keys() == seen.keys() | alone[0].keys()
    for name, one in dicts[0].items():
        assert np.array_equal(one, alone[0].get(name, seen[name]))


@pytest.mark.parametrize("duplicate", [copy.deepcopy, lambda one: pickle.loads(pickle.dumps(one))])  # noqa: S301
def test_a_copy_knows_the_slots_and_reads_its_own_road(road, duplicate):
    reader = StepReader(road, NAMES)
    read(reader)
    twin_road, twin = duplicate((road, reader))
    assert twin.slots == reader.slots != {}
    before = repr(read(twin))
    road.step()
    assert repr(read(twin)) == before != repr(read(reader))
    twin_road.step()
    assert repr(read(twin)) == repr(read(reader))
    twin_road.roads["is_done"] = 1
    assert twin.is_done[0]
    assert not reader.is_done[0]
