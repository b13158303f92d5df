"""Snapshots: roads continue from them; what is damaged or cannot be is refused."""

import subprocess
import sys
from hashlib import sha256

import numpy as np
import pytest
from staging import damped_actions

from marl_lanes import Simulator
from marl_lanes.traffic.snapshot import _DIGEST_SIZE

HEADER = 2 * _DIGEST_SIZE
CROWDED = {
    "drivers": {"mix": {"normal": 1.0, "aggressive": 1.0}},
    "followers": {"mix": {"cooperative": 1.0, "adversarial": 1.0, "learned": 1.0}},
    "command": {"probability": 1.0},
    "departures": {"interval": [2.0, 3.0]},
    "num_agents": None,
    "horizon": None,
}


def driven(scenario="five_lanes", num_envs=2, num_steps=150, seed=3, **overrides):
    simulator = Simulator(
        scenario, num_envs, seed=seed, learned_followers=True, overrides=CROWDED | overrides
    )
    simulator.reset()
    for _ in range(num_steps):
        simulator.step(damped_actions(simulator))
    return simulator


def resealed(snapshot):
    """The snapshot with the digest of its contents, as somebody who forges it would make it."""
    content = snapshot[HEADER:]
    return snapshot[:_DIGEST_SIZE] + sha256(content).digest() + content


def forged(simulator, table, field, index, value):
    """A snapshot with another value in one place, and the digest that fits."""
    changed = Simulator(simulator.scenario, simulator.num_envs, seed=0, learned_followers=True)
    changed.restore(simulator.snapshot())
    array = getattr(changed.state, table)
    (array[field] if field else array)[index] = value
    return changed.snapshot()


def flip(snapshot, bit):
    changed = bytearray(snapshot)
    changed[bit // 8] ^= 1 << bit % 8
    return bytes(changed)


@pytest.mark.parametrize("scenario", ["paper", "curved", "yielding", "interactive"])
def test_roads_continue_from_every_state(scenario):
    """In every step of whole episodes the roads pass the checks of a snapshot."""
    one = Simulator(scenario, 3, seed=5, overrides={"departures": {"interval": [2.0, 4.0]}})
    other = Simulator(one.scenario, 3, seed=0)
    other.restore(one.snapshot())
    one.reset()
    for step in range(700):
        one.step(damped_actions(one))
        if step % 7 == 0:
            other.restore(one.snapshot())
    assert other.initial_seed == 5
    other.restore(one.snapshot())
    one.step()
    other.step()
    assert one.state.tobytes() == other.state.tobytes()
    assert (one.roads["num_commands"] > 0).all()


@pytest.mark.parametrize(
    ("table", "field", "index", "value", "problem"),
    [
        ("vehicles", "profile", (0, 0), 9, r"vehicles\.profile\[0, 0\]: must be 0 to \d$"),
        ("vehicles", "lane", (1, 2), -1, r"vehicles\.lane\[1, 2\]: must be 0 to 4$"),
        ("vehicles", "lane_high", (0, 1), 5, r"vehicles\.lane_high.*: must be 0 to 4$"),
        ("vehicles", "agent", (0, 0), 99, r"vehicles\.agent.*: must be -1 to \d+$"),
        ("vehicles", "changer", (0, 0), 10**6, r"vehicles\.changer.*: must be -1 to \d+$"),
        ("vehicles", "disposition", (0, 0), 4, r"vehicles\.disposition.*: must be 0 to 3$"),
        ("vehicles", "speed", (0, 0), np.nan, r"vehicles\.speed\[0, 0\]: must be finite$"),
        ("vehicles", "position", (0, 0), np.inf, r"vehicles\.position.*: must be finite$"),
        ("vehicles", "speed", (0, slice(None)), -1.0, r"vehicles\.speed.*: must be at least 0$"),
        ("vehicles", "command_position", (0, 0), np.nan, r".*: must be a number or infinite$"),
        ("roads", "num_vehicles", 1, 10**9, r"roads\.num_vehicles\[1\]: must be 0 to \d+$"),
        ("roads", "num_vehicles", 1, 1, r"roads\.num_vehicles\[1\]: must be what the tables hold$"),
        ("roads", "num_live", 0, 0, r"roads\.num_live.*: must be what the tables hold$"),
        ("roads", "num_removed", 0, 7, r"roads\.num_removed.*: must be what the tables hold$"),
        ("roads", "num_ended", 0, 7, r"roads\.num_ended.*: must be what the tables hold$"),
        ("roads", "num_entered", 0, 0, r"roads\.num_entered.*: must be as many as there were$"),
        ("roads", "step", 0, -(2**40), r"roads\.step.*: must be 0 to \d+$"),
        ("order", None, (0, 0), 4_000_000_000, r"order\[0, 0\]: must be 0 to \d+$"),
        ("order", None, (0, slice(2)), 0, r"order\[0\]: must be every vehicle on the road, once"),
        ("agents", "vehicle", (0, slice(None)), 3, r"agents\.vehicle.*|vehicles\.agent.*"),
        ("agents", "target_lane", (0, slice(None)), 0, r"agents\.target_lane.*: must be beside$"),
        ("agents", "phase", (0, 0), 4, r"agents\.phase.*: must be 0 to 3$"),
        ("agents", "command", (0, 0), 999, r"agents\.command.*: must be below num_commands$"),
        ("lanes", "next_profile", (1, 4), -1, r"lanes\.next_profile\[1, 4\]: must be 0 to \d$"),
        ("lanes", "next_departure", (1, 4), 1e300, r"lanes\.next_departure.* longest interval$"),
        ("followers", "vehicle", (0, 0), -2, r"followers\.vehicle.*: must be -1 to \d+$"),
        ("followers", "policy", (0, 0), 1, r"followers\.policy.*: must be -1 to 0$"),
        ("collisions", "kind", (0, 3), 2, r"collisions\.kind\[0, 3\]: must be 0 to 1$"),
        ("observations", None, (0, 0, 0), np.nan, r"observations\[0, 0, 0\]: must be finite$"),
    ],
)
def test_what_kernels_rely_on_is_checked(roads, table, field, index, value, problem):
    snapshot = forged(roads, table, field, index, value)
    before = roads.state.tobytes()
    with pytest.raises(ValueError, match=rf"^snapshot: {problem}"):
        roads.restore(snapshot)
    assert roads.state.tobytes() == before


@pytest.fixture(scope="module")
def roads():
    return driven()


@pytest.mark.parametrize("given", [None, 3, "text", [], np.zeros(3)])
def test_a_snapshot_is_bytes(roads, given):
    with pytest.raises(ValueError, match=r"^snapshot = .*: must be bytes$"):
        roads.restore(given)


def test_a_damaged_snapshot_and_that_of_another_scenario_are_refused(roads):
    snapshot = roads.snapshot()
    before = roads.state.tobytes()
    for bit in np.random.default_rng(0).integers(8 * _DIGEST_SIZE, 8 * len(snapshot), 100):
        with pytest.raises(ValueError, match=r"^snapshot: is damaged"):
            roads.restore(flip(snapshot, int(bit)))
    with pytest.raises(ValueError, match=r"^snapshot: \d+ bytes, must be \d+$"):
        roads.restore(snapshot[:-1])
    slower = {"drivers": {"profiles": {"normal": {"time_headway": 1.75}}}}
    other = Simulator(roads.scenario, 2, seed=0, learned_followers=True, overrides=slower)
    assert len(other.snapshot()) == len(snapshot)
    with pytest.raises(ValueError, match=r"^snapshot: is of another scenario$"):
        roads.restore(other.snapshot())
    assert roads.state.tobytes() == before
    roads.restore(snapshot)
    assert roads.state.tobytes() == before


FORGE = """
import sys
import numpy as np
sys.path.insert(0, sys.argv[1])
from test_snapshot import HEADER, driven, flip, resealed

refused = driven_on = 0
generator = np.random.default_rng(int(sys.argv[3]))
for _ in range(int(sys.argv[2]) // 25):
    scenario = ("five_lanes", "yielding", "curved")[_ % 3]
    roads = driven(scenario, 1, int(generator.integers(60, 260)), int(generator.integers(99)))
    twin = driven(scenario, 1, 0)
    snapshot = roads.snapshot()
    for bit in generator.integers(8 * HEADER, 8 * len(snapshot), 25):
        forged = resealed(flip(snapshot, int(bit)))
        try:
            twin.restore(forged)
        except ValueError:
            refused += 1
            continue
        driven_on += 1
        for step in range(50):
            twin.step(np.full(twin.actions.shape, 0.1))
            if step == 25:
                twin.advance_until_live()
print(refused, driven_on)
"""


@pytest.mark.slow
@pytest.mark.parametrize("number", [100, pytest.param(2000, marks=pytest.mark.long)])
def test_forged_snapshots_never_crash_the_interpreter(request, number):
    done = subprocess.run(
        [sys.executable, "-c", FORGE, str(request.path.parent), str(number), "1"],
        cwd=request.path.parents[1],
        capture_output=True,
        text=True,
        timeout=1200,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    refused, driven_on = map(int, done.stdout.split())
    assert refused + driven_on == number
    assert min(refused, driven_on) > number / 20
