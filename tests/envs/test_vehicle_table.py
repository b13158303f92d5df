"""All vehicles as one table: against the simulator's own."""

import numpy as np

from marl_lanes import parallel_env
from marl_lanes.envs.vehicle_table import STATE_COLUMNS
from marl_lanes.traffic.machine.state import NONE


def test_state_shows_every_vehicle_by_decreasing_position():
    road = parallel_env("dense", seed=0)
    road.reset(seed=0)
    commanded = set()
    while road.agents:
        state = road.state()
        assert road.state_space.contains(state)
        count = int(road.simulator.roads["num_vehicles"][0])
        rows = dict(zip(STATE_COLUMNS, state.T, strict=True))
        cars = road.simulator.vehicles[0]
        present = cars[cars["id"] != NONE]
        present = present[np.argsort(-present["position"], kind="stable")]
        assert len(present) == count > 5
        for name in STATE_COLUMNS[:-1]:
            assert np.array_equal(rows[name][:count], present[name].astype(np.float32))
        assert not state[count:, :-1].any()
        assert (rows["agent"][count:] == NONE).all()
        serials = rows["agent"][:count]
        live = {f"changer_{int(serial)}" for serial in serials[serials != NONE]}
        assert live == set(road.agents)
        commanded |= live
        road.step({agent: np.zeros(1, np.float32) for agent in road.agents})
    assert commanded == set(road.possible_agents)
