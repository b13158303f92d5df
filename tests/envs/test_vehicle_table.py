"""All vehicles as one table: against the simulator's own."""

from functools import partial

import numpy as np
import torch
from staging import TRUCK

from marl_lanes import LaneChangeEnv, parallel_env
from marl_lanes.envs.vehicle_table import read_vehicle_table, state_columns
from marl_lanes.traffic.machine.state import NONE, Outcome


def test_state_shows_every_vehicle_by_decreasing_position():
    road = parallel_env("dense", seed=0)
    road.reset(seed=0)
    commanded, columns = set(), state_columns(road.scenario)
    motion = "position", "lateral_position", "speed", "acceleration", "yaw", "yaw_rate"
    assert columns == (*motion, "agent")
    while road.agents:
        state = road.state()
        assert road.state_space.contains(state)
        count = int(road.simulator.roads["num_vehicles"][0])
        rows = dict(zip(columns, state.T, strict=True))
        cars = road.simulator.vehicles[0]
        present = cars[cars["id"] != NONE]
        present = present[np.argsort(-present["position"], kind="stable")]
        assert len(present) == count > 5
        for name in columns[:-1]:
            assert np.array_equal(rows[name][:count], present[name].astype(np.float32))
        assert not state[count:, :-1].any()
        assert (rows["agent"][count:] == NONE).all()
        serials = rows["agent"][:count]
        live = {f"changer_{int(serial)}" for serial in serials[serials != NONE]}
        assert live == set(road.agents)
        commanded |= live
        road.step({agent: np.zeros(1, np.float32) for agent in road.agents})
    assert commanded == set(road.possible_agents)


def test_every_road_of_the_batched_environment_has_its_state():
    """As each road alone has it, but with slots in place of the commands' numbers."""
    make = partial(LaneChangeEnv, "dense", seed=0, overrides={"command": {"probability": 1.0}})
    env, plain = make(num_envs=3, has_state=True), make(num_envs=3)
    alone = [make(num_envs=1, first_road=road) for road in range(3)]
    step, other = env.reset(), plain.reset()
    assert "state" not in other.keys()  # noqa: SIM118
    steps = [one.reset() for one in alone]
    seen = set()
    for _ in range(30):
        assert env.observation_spec.contains(step.select(*env.observation_spec.keys()))
        for road, one in enumerate(alone):
            table = read_vehicle_table(one.simulator)
            found = step["state"][road].numpy()
            assert np.array_equal(found[:, :-1], table[:, :-1])
            commands = one.simulator.agents["command"][0]
            slots = found[:, -1].astype(int)
            assert np.array_equal(slots == NONE, table[:, -1] == NONE)
            assert np.array_equal(commands[slots[slots != NONE]], table[slots != NONE, -1])
            seen |= set(slots.tolist())
        step = env.step(env.full_action_spec.zero().update(step))["next"]
        steps = [
            one.step(one.full_action_spec.zero().update(now))["next"]
            for one, now in zip(alone, steps, strict=True)
        ]
    assert seen >= {NONE, 0, 1}


def test_an_agent_is_in_the_state_of_the_step_in_which_its_time_is_over():
    """A critic bootstraps from it, and must know which vehicle it is."""
    overrides = {"command": {"probability": 1.0, "time_limit": 3.0}, "num_agents": 12}
    road = parallel_env("dense", seed=0, overrides=overrides)
    _, infos = road.reset(seed=0)
    seen = set()
    while road.agents:
        told = {name for name, info in infos.items() if info["outcome"] == Outcome.TIMED_OUT}
        serials = road.state()[:, -1]
        shown = {f"changer_{int(serial)}" for serial in serials[serials != NONE]}
        # Not where the road went on without an agent: then the state is of a later step.
        assert set(road.agents) <= shown <= told | set(road.agents)
        seen |= shown & told
        *_, infos = road.step({agent: np.zeros(1) for agent in road.agents})
    assert seen
    env = LaneChangeEnv("dense", 4, seed=0, overrides=overrides, has_state=True)
    after = env.rollout(100, break_when_any_done=False)["next"]
    outcome, slots = after["changers", "outcome"], after["state"][..., -1]
    is_shown = (slots.unsqueeze(-1) == torch.arange(env.simulator.num_slots)).any(-2)
    is_timed_out = outcome == Outcome.TIMED_OUT
    assert is_timed_out.sum() > 5
    assert torch.equal(is_shown, after["changers", "mask"] | is_timed_out)


def test_with_vehicles_of_several_sizes_the_state_shows_each_size():
    """A critic must know them: gaps are between bumpers, and positions are those of centres."""
    road = parallel_env("trucks", seed=2)
    road.reset()
    assert state_columns(road.scenario)[-3:] == ("length", "width", "agent")
    state, cars = road.state(), road.simulator.vehicles[0]
    assert road.state_space.contains(state)
    count = int(road.simulator.roads["num_vehicles"][0])
    order = road.simulator.state.order[0, :count]
    is_truck = cars["profile"][order] == TRUCK
    assert set(is_truck.tolist()) == {True, False}
    sizes = np.where(is_truck[:, None], [16.5, 2.55], [4.8, 1.8]).astype(np.float32)
    assert np.array_equal(state[:count, -3:-1], sizes)
    assert not state[count:, -3:-1].any()
    env = LaneChangeEnv("trucks", 2, seed=2, has_state=True)
    step = env.reset()
    assert env.observation_spec.contains(step.select(*env.observation_spec.keys()))
    assert step["state"].shape == (2, road.scenario.max_vehicles, 9)
    alone = read_vehicle_table(env.simulator)
    assert np.array_equal(step["state"][0, :, :-1].numpy(), alone[:, :-1])
