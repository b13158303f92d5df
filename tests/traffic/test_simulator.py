"""The simulator: reproducible bytes, independent roads, checked arguments."""

import copy
import json
import os
import pickle
import subprocess
import sys

import numpy as np
import pytest
from staging import command, damped_actions, stage

from marl_lanes.scenario import ScenarioError
from marl_lanes.traffic.machine.state import Phase
from marl_lanes.traffic.simulator import MAX_WAIT, Simulator

MIXED = {
    "drivers": {"mix": {"normal": 1.0, "aggressive": 1.0, "defensive": 1.0}},
    "followers": {"mix": {"cooperative": 1.0, "neutral": 1.0, "adversarial": 1.0}},
    "command": {"probability": 1.0},
    "departures": {"interval": [2.0, 4.0]},
    "warmup": [20.0, 30.0],
    "max_vehicles": 96,
}


def actions_of(step, num_envs, num_slots):
    """(E, A, 1) random actions; row e is the same for every number of roads."""
    generators = [np.random.default_rng((step, env)) for env in range(num_envs)]
    return np.stack([generator.uniform(-0.5, 0.5, (num_slots, 1)) for generator in generators])


def rollout(simulator, num_steps, start=0):
    """The state's bytes of every road after every step."""
    rows = []
    for step in range(start, start + num_steps):
        simulator.step(actions_of(step, simulator.num_envs, simulator.num_slots))
        rows.append([row_bytes(simulator, env) for env in range(simulator.num_envs)])
    return rows


def row_bytes(simulator, env):
    """The bytes of every field of one road, without the padding between fields."""
    rows = []
    for array in simulator.state.arrays:
        rows += (
            [array[name][env] for name in array.dtype.names] if array.dtype.names else [array[env]]
        )
    return b"".join(row.tobytes() for row in rows)


def made(num_envs, *, seed=4, num_threads=1, scenario="five_lanes"):
    simulator = Simulator(scenario, num_envs, seed=seed, num_threads=num_threads, overrides=MIXED)
    simulator.reset()
    return simulator


@pytest.mark.parametrize(("num_envs", "num_threads"), [(3, 1), (3, 2), (5, 2), (5, 3), (7, 7)])
def test_a_road_does_not_depend_on_the_batch_or_the_threads(num_envs, num_threads):
    expected = rollout(made(5), 80)
    found = rollout(made(num_envs, num_threads=num_threads), 80)
    shared = min(num_envs, 5)
    assert [rows[:shared] for rows in found] == [rows[:shared] for rows in expected]


def test_the_roads_of_a_batch_differ():
    last = rollout(made(4), 20)[-1]
    assert len(set(last)) == 4


def test_the_same_seed_and_actions_give_the_same_bytes_and_another_seed_others():
    simulator, other = made(2), made(2, seed=5)
    assert rollout(simulator, 100) == rollout(made(2), 100)
    assert rollout(other, 100)[-1] != [row_bytes(simulator, env) for env in range(2)]
    ours, theirs = simulator.vehicles["position"], other.vehicles["position"]
    assert np.intersect1d(ours[ours > 0.0], theirs[theirs > 0.0]).size == 0


def test_a_used_simulator_seeded_again_runs_the_same_episode():
    fresh, used = made(2), made(2, seed=99)
    rollout(used, 50)
    used.seed(4)
    used.reset()
    for step in range(100):
        actions = actions_of(step, 2, fresh.num_slots)
        fresh.step(actions)
        used.step(actions)
        for name in fresh.roads.dtype.names:
            assert (fresh.roads[name] == used.roads[name]).all(), name
        assert (fresh.state.observations == used.state.observations).all()
        assert (fresh.agents["reward"] == used.agents["reward"]).all()
        is_there = fresh.vehicles["id"] >= 0
        assert (is_there == (used.vehicles["id"] >= 0)).all()
        assert fresh.vehicles[is_there].tobytes() == used.vehicles[is_there].tobytes()


def test_a_reset_continues_the_random_numbers():
    simulator = made(1)
    first = simulator.vehicles["position"].copy()
    simulator.reset()
    assert (simulator.vehicles["position"] != first).any()


def test_a_masked_reset_leaves_the_other_roads_bytes():
    simulator = made(4)
    rollout(simulator, 60)
    before = [row_bytes(simulator, env) for env in range(4)]
    simulator.reset([False, True, False, True])
    after = [row_bytes(simulator, env) for env in range(4)]
    assert [old == new for old, new in zip(before, after, strict=True)] == [True, False] * 2
    assert simulator.roads["step"].tolist() == [60, 0, 60, 0]
    assert (simulator.roads["num_collisions"][[1, 3]] == 0).all()


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda s: pickle.loads(pickle.dumps(s))])  # noqa: S301
@pytest.mark.parametrize("num_threads", [1, 2])
def test_a_copy_during_a_rollout_continues_identically_and_separately(copied, num_threads):
    simulator = made(3, num_threads=num_threads)
    rollout(simulator, 40)
    twin = copied(simulator)
    at_copy = [row_bytes(simulator, env) for env in range(3)]
    expected = rollout(simulator, 40, 40)
    assert [row_bytes(twin, env) for env in range(3)] == at_copy
    assert rollout(twin, 40, 40) == expected


def test_advance_until_live_stops_with_a_live_agent():
    simulator = Simulator("paper", 6, seed=2)
    simulator.reset()
    simulator.advance_until_live()
    assert (simulator.roads["num_live"] >= 1).all()
    assert len(set(simulator.roads["step"].tolist())) > 2
    before = simulator.state.tobytes()
    simulator.advance_until_live()
    assert simulator.state.tobytes() == before


def test_advance_until_live_stops_at_the_horizon():
    overrides = {"command": {"probability": 0.0}, "horizon": 20.0}
    simulator = Simulator("paper", 2, overrides=overrides, seed=0)
    simulator.reset()
    simulator.advance_until_live()
    assert (simulator.roads["is_done"] == 1).all()
    assert (simulator.roads["step"] == 200).all()


@pytest.mark.parametrize(
    "overrides",
    [
        {"departures": {"interval": [1e6, 1e6]}},
        {"command": {"probability": 1e-300}},
        # At this speed no vehicle is there in a day.
        {
            "road": {"length": 100_000.0},
            "command": {"position": [90_000.0, 90_000.0]},
            "departures": {"desired_speed": [0.5, 0.5], "initial_speed": [0.5, 0.5]},
            "max_vehicles": 4,
        },
        {"command": {"probability": 0.0}},
    ],
    ids=["no departures", "no commands", "out of reach", "probability 0"],
)
def test_waiting_for_a_command_that_does_not_come_is_an_error(overrides):
    fields = {"horizon": None, "time_step": 0.5, "lane_keeping": {"pole": 1.0}}
    simulator = Simulator("paper", seed=0, overrides={**fields, **overrides})
    simulator.reset()
    with pytest.raises(ScenarioError, match="horizon = null"):
        simulator.advance_until_live()
    assert simulator.roads["step"][0] * 0.5 <= MAX_WAIT


def test_actions_are_clipped_to_the_scenarios_bound():
    twins = [made(2, scenario="paper") for _ in range(2)]
    shape = (2, twins[0].num_slots, 1)
    num_steered = 0
    for _ in range(150):
        twins[0].step(np.full(shape, 0.5))
        twins[1].step(np.full(shape, 1e300))
        num_steered += int((twins[0].agents["steering_steps"] > 0).sum())
    assert twins[0].state.tobytes() == twins[1].state.tobytes()
    assert num_steered > 10


def test_no_actions_are_zeros():
    twins = [made(2, scenario="paper") for _ in range(2)]
    for _ in range(30):
        twins[0].step()
        twins[1].step(np.zeros((2, twins[1].num_slots, 1)))
    assert twins[0].state.tobytes() == twins[1].state.tobytes()


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_an_action_that_is_not_finite_is_refused_if_its_agent_steers(value):
    simulator = Simulator("paper", 2, overrides={"warmup": [0.0, 0.0]}, seed=0)
    simulator.reset()
    stage(simulator, {"lane": 1, "position": 300.0}, env=1)
    slot = command(simulator, 0, 1, Phase.ENGAGED, env=1)
    actions = np.zeros((2, simulator.num_slots, 1))
    actions[1, slot] = value
    before = simulator.state.tobytes()
    with pytest.raises(ValueError, match=r"actions\[1, 0, 0\] = .*: must be a finite acc"):
        simulator.step(actions)
    assert simulator.state.tobytes() == before
    actions[1, slot] = 0.0
    actions[0, :] = actions[1, slot + 1] = value
    simulator.step(actions)
    assert np.isfinite(simulator.vehicles[1, 0]["yaw"])


def test_a_second_action_must_be_finite_while_its_agent_waits():
    simulator = Simulator("interactive", 1, overrides={"warmup": [0.0, 0.0]}, seed=0)
    simulator.reset()
    stage(simulator, {"lane": 1, "position": 300.0})
    slot = command(simulator, 0, 1, Phase.WAITING)
    actions = np.zeros((1, simulator.num_slots, 2))
    actions[0, slot, 1] = np.nan
    with pytest.raises(ValueError, match=r"actions\[0, 0, 1\] = nan: must be a finite acc"):
        simulator.step(actions)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"num_envs": 0}, "num_envs = 0: must be a whole number, 1 to "),
        ({"num_threads": 0}, "num_threads = 0: must be a whole number, 1 to 1024"),
        ({"first_road": -1}, "first_road = -1: must be a whole number, 0 to "),
        ({"seed": -1}, "seed = -1: must be a whole number, 0 to"),
        ({"seed": 2**64}, "seed = 18446744073709551616: must be a whole number, 0 to"),
    ],
)
def test_arguments_out_of_range_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        Simulator("paper", **arguments)


def test_wrong_shapes_are_refused():
    simulator = Simulator("paper", 3, seed=0)
    with pytest.raises(ValueError, match=r"mask: shape \(2,\), must be \(3,\)"):
        simulator.reset([True, False])
    with pytest.raises(ValueError, match=r"actions: shape \(3, 8\), must be \(3, 8, 1\)"):
        simulator.step(np.zeros((3, 8)))
    with pytest.raises(ValueError, match=r"follower_actions: shape \(3, 8\), must be \(3, 8, 1\)"):
        simulator.step(None, np.zeros((3, 8)))


def test_the_masks_show_live_steering_and_ended_agents():
    simulator = made(3, scenario="paper")
    seen = np.zeros(3, bool)
    for _ in range(300):
        simulator.step(damped_actions(simulator))
        live, engaged, over = simulator.is_live, simulator.is_steering, simulator.has_ended
        assert (live.sum(axis=1) == simulator.roads["num_live"]).all()
        assert (live | ~engaged).all()
        assert not (live & over).any()
        assert not simulator.state.observations[~live & ~over].any()
        seen |= [live.any(), engaged.any(), over.any()]
    assert seen.all()


ROLLOUT = """
import json, sys
import numba, numpy as np
from marl_lanes.traffic.simulator import Simulator

overrides = json.loads(sys.argv[1])
simulator = Simulator("curved", 1, seed=3, overrides=overrides)
simulator.reset()
generator, rewards, outcomes = np.random.default_rng(0), 0.0, []
for _ in range(90):
    simulator.step(generator.uniform(-0.2, 0.3, (1, simulator.num_slots, 1)))
    rewards += float(simulator.agents["reward"].sum())
    outcomes += simulator.agents["outcome"][simulator.has_ended].tolist()
is_there = simulator.vehicles["id"] >= 0
result = {name: simulator.vehicles[name] for name in simulator.vehicles.dtype.names}
result = {name: values[is_there].tolist() for name, values in result.items()}
result |= {name: simulator.roads[name].tolist() for name in simulator.roads.dtype.names}
result |= {"rewards": rewards, "outcomes": outcomes, "is_jit": not numba.config.DISABLE_JIT}
result["observations"] = simulator.state.observations.ravel().tolist()
json.dump(result, sys.stdout)
"""


@pytest.mark.slow
def test_the_interpreted_kernel_is_the_compiled_one():
    """All kernels also run as plain Python, for coverage and debuggers."""
    overrides = {
        **MIXED,
        "command": {"probability": 1.0, "position": [40.0, 60.0]},
        "warmup": [12.0, 12.0],
        "road": {"arcs": [{"start": 50.0, "end": 150.0, "radius": 200.0}]},
        "gap": {"rule": "kinematic", "minimum_gap": 0.0, "time_gap": 0.1},
        "completion": {"max_deviation": 1.0},
        "horizon": 9.0,
    }
    results = []
    for is_off in ("0", "1"):
        done = subprocess.run(
            [sys.executable, "-W", "error", "-c", ROLLOUT, json.dumps(overrides)],
            env={**os.environ, "NUMBA_DISABLE_JIT": is_off},
            capture_output=True,
            text=True,
            timeout=120,
            check=False,
        )
        assert done.returncode == 0, done.stderr
        results.append(json.loads(done.stdout))
    compiled, interpreted = results
    assert (compiled.pop("is_jit"), interpreted.pop("is_jit")) == (True, False)
    assert compiled["outcomes"] == interpreted["outcomes"]
    assert compiled["num_commands"][0] > 1
    assert compiled["outcomes"]
    assert compiled.keys() == interpreted.keys()
    for name, values in compiled.items():
        assert interpreted[name] == pytest.approx(values, rel=1e-9, abs=1e-12), name
