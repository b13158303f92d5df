"""Run with numba's simulation of CUDA: the same roads on the CPU and on the simulated GPU."""

import gc
import os
import sys
import threading
import weakref
from collections import defaultdict
from copy import deepcopy

os.environ |= {"NUMBA_ENABLE_CUDASIM": "1", "NUMBA_DISABLE_JIT": "1"}

import numpy as np
import pytest

from marl_lanes import Simulator
from marl_lanes.envs.vehicle_table import read_vehicle_tables, state_columns
from marl_lanes.traffic import gpu
from marl_lanes.traffic.machine import team
from marl_lanes.traffic.machine.state import NONE, Outcome, Phase

SMALL = {
    "num_agents": None,
    "horizon": None,
    "num_slots": 3,
    "max_vehicles": 12,
    "warmup": [6.0, 8.0],
    "command": {
        "position": [10.0, 20.0],
        "probability": 1.0,
        "lanes": [0, 1, 2],
        "time_limit": 1.0,
    },
    "followers": {"mix": {"learned": 0.5, "late-yielder": 0.5}},
    "drivers": {"mix": {"normal": 0.5, "truck": 0.5}},
}


TEAM_SIZE = 4


class SimulatedCrew:
    """The simulated threads of a block's first dimension; outside a kernel a road has one."""

    def __init__(self):
        self._lock = threading.Lock()
        self._barriers = defaultdict(lambda: threading.Barrier(self.size))
        self._values = defaultdict(dict)
        self.most = 1

    @property
    def is_team(self):
        return hasattr(threading.current_thread(), "threadIdx")

    @property
    def member(self):
        return threading.current_thread().threadIdx.x if self.is_team else 0

    @property
    def size(self):
        return threading.current_thread()._manager._block_dim[0] if self.is_team else 1

    def gather(self, value):
        if not self.is_team:
            return [value]
        thread = threading.current_thread()
        of = *thread.blockIdx, thread.threadIdx.y
        with self._lock:
            self.most = max(self.most, self.member + 1)
            barrier = self._barriers[of]
        self._values[of][self.member] = value
        barrier.wait()
        values = [self._values[of][number] for number in range(self.size)]
        barrier.wait()
        return values


team.crew = SimulatedCrew()


# Python's threads take long to meet: many of them, and each for as long as it may go on alone.
gpu._choose_team = lambda _: TEAM_SIZE
sys.setswitchinterval(1e-5)


def make(device):
    options = {"overrides": SMALL, "learned_followers": True}
    simulator = Simulator("hidden", 2, seed=3, device=device, **options)
    simulator.reset()
    return simulator


def drive(rng, simulators, num_steps=1):
    for _ in range(num_steps):
        actions = rng.uniform(-0.1, 0.1, simulators[0].actions.shape)
        for simulator in simulators:
            simulator.step(actions, actions[..., :1])


def assert_same(here, there):
    assert here.state.tobytes() == there.state.tobytes()


def assert_table_is_read(rng, simulator):
    """The kernel's columns are those of the processors, as far as no bound cuts them."""
    from marl_lanes.traffic.gpu_kernels import read_vehicles

    simulator = deepcopy(simulator)
    *numbers, length, width, _ = state_columns(simulator.scenario)
    assert (length, width) == ("length", "width")
    for number, name in enumerate(numbers):
        simulator.vehicles[name] = number + rng.random(simulator.vehicles.shape)
    env, slot = np.argwhere(simulator.is_live)[0]
    agent = simulator.agents[env, slot]
    simulator.vehicles["agent"][env, agent["vehicle"]] = NONE
    agent["phase"], agent["outcome"] = Phase.ABSENT, Outcome.TIMED_OUT
    simulator.roads["num_ended"][env] = 1
    expected = read_vehicle_tables(simulator)
    assert slot in expected[env, :, -1]
    rows = np.full_like(expected, np.nan)
    state = simulator.state
    profiles = simulator.parameters.profiles
    tables = state.roads, state.order, state.vehicles, state.agents
    read_vehicles[1, 4](*tables, profiles, rows)
    np.testing.assert_array_equal(rows, expected)


def assert_refusal_keeps_the_roads(rng, here, there):
    """Not even a reset changes them before the error has told of it, however late it comes."""
    from marl_lanes.traffic.gpu_kernels import REFUSED

    roads = there.gpu_roads
    before = [np.array(table) for table in roads.tables.arrays]
    # As on a GPU that the host is ahead of.
    roads._refused[0] = 1
    there.reset([True, False])
    there.step(np.zeros(there.actions.shape))
    for table, kept in zip(roads.tables.arrays, before, strict=True):
        assert np.array(table).tobytes() == kept.tobytes()
    for call in (there.reset, there.step, lambda: there.restore(here.snapshot())):
        roads._refused[0] = roads._alarms[REFUSED] = 1
        with pytest.raises(ValueError, match="must be a finite acceleration"):
            call()
    drive(rng, [here, there])
    assert_same(here, there)


def main():
    rng = np.random.default_rng(0)
    here, there = make("cpu"), make("cuda")
    assert_same(here, there)
    drive(rng, [here, there], 15)
    assert_same(here, there)
    assert here.is_live.any()
    assert (here.roads["num_commands"] > here.roads["num_live"]).any(), "no time was over"
    assert not there.is_on_gpu  # a policy drives followers on the host
    assert there.initial_seed == 3
    assert_table_is_read(rng, here)
    copy = deepcopy(there)
    for simulator in (here, there):
        simulator.reset([True, False])
    assert_same(here, there)
    drive(rng, [here, there])
    assert_same(here, there)
    assert_refusal_keeps_the_roads(rng, here, there)
    copy.restore(here.snapshot())
    drive(rng, [here, copy])
    assert_same(here, copy)
    # Its memory on the GPU is free as soon as nobody has it.
    roads = weakref.ref(copy.gpu_roads)
    gc.disable()
    del copy
    assert roads() is None
    assert team.crew.most == there.gpu_roads.team_size == TEAM_SIZE
    sys.stdout.write("equal\n")


if __name__ == "__main__":
    main()
