"""Recorded trajectories: a digest of every field of the state, for a dozen scenarios.

They tell whether a change of the code has changed what happens on the roads. Where that is meant,
record them anew with ``python tests/golden.py``: the difference of ``golden.json`` then shows which
scenarios and which fields have changed.
"""

import hashlib
import json
import math
import sys
from pathlib import Path

import numpy as np

from marl_lanes.scenario import list_scenarios, load_scenario
from marl_lanes.traffic.machine.compiled import compiled
from marl_lanes.traffic.roles.changer import CHANGER
from marl_lanes.traffic.roles.follower import FOLLOWER
from marl_lanes.traffic.simulator import Simulator

ROLES = {role.table: role for role in (CHANGER, FOLLOWER)}
FILE = Path(__file__).with_suffix(".json")
SEED = 20_180_703
LONG = {"num_roads": 64, "num_steps": 400, "overrides": {}}
SHORT = {"num_roads": 1, "num_steps": 60, "overrides": {"warmup": [15.0, 20.0]}}
"""For where the kernels are interpreted, hundreds of times slower."""

MIXED = {
    "road": {
        "num_lanes": 5,
        "arcs": [
            {"start": 200.0, "end": 400.0, "radius": 300.0},
            {"start": 500.0, "end": 900.0, "radius": -250.0},
        ],
    },
    "drivers": {
        "mix": {"normal": 1.0, "aggressive": 1.0, "defensive": 1.0},
        "car_following": "acc",
    },
    "departures": {"interval": [1.5, 4.0]},
    "command": {"probability": 0.8},
    "num_agents": None,
    "horizon": None,
    "max_vehicles": 128,
    "followers": {
        "mix": {"cooperative": 1.0, "neutral": 1.0, "adversarial": 1.0},
        "cooperative": {"moves_over": True},
    },
    "action": {"longitudinal": {}},
    "reward": {"delay_weight": 0.1, "longitudinal_weight": 0.02},
}
LEARNED = {
    "followers": {"mix": {"learned": 2.0, "neutral": 1.0, "adversarial": 1.0}},
    "departures": {"interval": [2.0, 5.0]},
    "command": {"probability": 0.7},
    "num_agents": None,
}
HASTY = {
    "departures": {"interval": [2.0, 5.0]},
    "command": {"probability": 0.7, "lanes": [0, 1, 2], "time_limit": 7.0},
    "num_agents": None,
}


SCENARIOS = {
    **{name: (name, {}) for name in list_scenarios()},
    "mixed": ("paper", MIXED),
    "learned": ("paper", LEARNED),
    "hasty": ("paper", HASTY),
}
"""Every shipped scenario, one with mixed drivers, one with learned followers, one with commands in
all lanes and a time limit: base, overrides."""


def choose_actions(simulator, generator):
    """Seeded actions: anything on every third road; on the others a steering to the target lane."""
    shape = simulator.actions.shape
    noise = generator.uniform(-1.0, 1.0, shape)
    braking_or_more = generator.uniform(-3.5, 3.5, (*shape[:2], 1))
    agents = simulator.agents
    cars = np.take_along_axis(simulator.vehicles, np.maximum(agents["vehicle"], 0), axis=1)
    lane = np.where(agents["phase"] == 3, agents["origin_lane"], agents["target_lane"])
    error = (lane + 0.5) * simulator.scenario.road.lane_width - cars["lateral_position"]
    pull = 1.7 * np.clip(error, -2.0, 2.0) / np.maximum(cars["speed"], 5.0)
    steering = agents["direction"] * (pull - 3.6 * cars["yaw"] - 3.0 * cars["yaw_rate"])
    is_wild = (np.arange(shape[0]) % 3 == 0)[:, None]
    actions = np.array(noise)
    actions[..., 0] = np.where(is_wild, noise[..., 0], steering + 0.02 * noise[..., 0])
    actions[..., 1:] *= 2.5
    return actions, braking_or_more


def record(name, *, num_roads, num_steps, overrides):
    """Digests by table and field, over all steps from a reset on."""
    base, changes = SCENARIOS[name]
    simulator = Simulator(
        load_scenario(base, changes),
        num_roads,
        seed=SEED,
        overrides=overrides,
        learned_followers=name == "learned",
    )
    generator = np.random.default_rng(SEED)
    simulator.reset()
    digests = {}

    def digest(name, values):
        found = digests.setdefault(name, hashlib.blake2b(digest_size=8))
        found.update(np.ascontiguousarray(values).tobytes())

    state = simulator.state
    for _ in range(num_steps):
        simulator.step(*choose_actions(simulator, generator))
        for table in ("roads", "lanes", "vehicles", "agents", "followers", "collisions"):
            for field, values in columns(table, getattr(state, table)):
                digest(f"{table}.{field}", values)
        for array in ("order", "observations", "follower_observations"):
            digest(array, getattr(state, array))
    return {name: found.hexdigest() for name, found in digests.items()}


def columns(name, table):
    """Name and values of every field, the terms of a reward by their own names."""
    for field in table.dtype.names:
        if field == "terms":
            for index, term in enumerate(ROLES[name].terms):
                yield f"terms.{term.name}", table[field][..., index]
        else:
            yield field, table[field]


@compiled
def _arithmetic(numbers):
    for index in range(numbers.shape[0]):
        x = numbers[index]
        numbers[index] = math.sin(x) + math.cos(x) + math.sqrt(x) + x**3.7


def fingerprint():
    """A digest of this machine's elementary functions: others round the last bit differently."""
    numbers = np.random.default_rng(SEED).uniform(0.0, 3.0, 10_000)
    _arithmetic(numbers)
    return hashlib.blake2b(numbers.tobytes(), digest_size=8).hexdigest()


def main():
    """Record anew; or, with ``short NAME ...``, write out the short ones of some scenarios."""
    if sys.argv[1:2] == ["short"]:
        json.dump({name: record(name, **SHORT) for name in sys.argv[2:]}, sys.stdout)
        return
    recorded = {
        "fingerprint": fingerprint(),
        "long": {name: record(name, **LONG) for name in SCENARIOS},
        "short": {name: record(name, **SHORT) for name in SCENARIOS},
    }
    FILE.write_text(json.dumps(recorded, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
