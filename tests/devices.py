"""Roads on a GPU held against those on the CPU, and whether there is a GPU."""

import numpy as np
import pytest
import torch

from marl_lanes.traffic.machine.graphics import find_gpu

TOLERANCE = 1e-9
LONGITUDINAL = {"max_acceleration": 2.0, "max_braking": 3.0, "max_speed": 40.0}
"""``action.longitudinal`` of a scenario with two actions."""


def find_reason():
    """Why nothing can run on a GPU here; None if it can."""
    if not torch.cuda.is_available():
        return "torch can use none"
    try:
        find_gpu(0)
    except ValueError as error:
        return str(error)
    return None


REASON = find_reason()
needs_gpu = pytest.mark.skipif(REASON is not None, reason=f"no GPU: {REASON}")


def assert_same(one, other):
    """Whole numbers are equal, floats within the tolerance; the arguments are two simulators."""
    for name in ("roads", "lanes", "vehicles", "order", "agents", "followers", "collisions"):
        here, there = getattr(one.state, name), getattr(other.state, name)
        if name == "order":
            # Behind the last vehicle it holds what was there before.
            counts = one.roads["num_vehicles"][:, None]
            is_used = np.arange(here.shape[1]) < counts
            assert_close(name, np.where(is_used, here, 0), np.where(is_used, there, 0))
            continue
        for field in here.dtype.names:
            assert_close(f"{name}.{field}", here[field], there[field])
    for name in ("observations", "follower_observations"):
        # float32: one unit in the last place where a float64 is between two of them.
        assert_close(name, getattr(one.state, name), getattr(other.state, name), 1e-6)


def assert_close(name, here, there, tolerance=TOLERANCE):
    if here.dtype.kind != "f":
        wrong = np.argwhere(here != there)
        assert len(wrong) == 0, (name, wrong[0], len(wrong), here[tuple(wrong[0])])
        return
    np.testing.assert_allclose(there, here, rtol=tolerance, atol=tolerance, err_msg=name)


def draw(rng, simulator):
    """Actions of which some are small, some at the bounds and a few beyond them."""
    shape = simulator.num_envs, simulator.num_slots
    scale = rng.choice([0.02, 0.2, 0.6], (*shape, 1))
    steering = rng.uniform(-1.0, 1.0, (*shape, 1)) * scale
    longitudinal = rng.uniform(-4.0, 3.0, (*shape, 1))
    return np.concatenate([steering, longitudinal], -1)[..., : simulator.num_actions]
