"""Normalised observations and actions against the plain ones."""

import numpy as np
import pytest
from pettingzoo.test import parallel_api_test

from marl_lanes import parallel_env
from marl_lanes.traffic.roles.changer import CHANGER

FEW = {"num_agents": 2}


def test_it_is_the_same_road_in_other_units():
    scaled = parallel_env("interactive", normalised=True, overrides=FEW, seed=0)
    plain = parallel_env("interactive", overrides=FEW, seed=0)
    columns = CHANGER.seen(plain.scenario)
    offsets, scales = (np.array([getattr(c, key) for c in columns]) for key in ("offset", "scale"))
    (rows, _), (seen, _) = scaled.reset(), plain.reset()
    rng = np.random.default_rng(0)
    largest = []
    while plain.agents:
        assert scaled.agents == plain.agents
        for name, row in rows.items():
            assert row.dtype == np.float32
            assert scaled.observation_space(name).contains(row)
            np.testing.assert_allclose(row * scales + offsets, seen[name], rtol=1e-5, atol=1e-4)
            largest.append(np.abs(row).max())
        parts = {name: rng.uniform(-1.2, 1.2, 2) for name in plain.agents}
        low, high = np.array([-0.5, -3.0]), np.array([0.5, 2.0])
        actions = {name: np.where(a < 0.0, -a * low, a * high) for name, a in parts.items()}
        (rows, *told), (seen, *others) = scaled.step(parts), plain.step(actions)
        assert repr(told) == repr(others)
    assert np.median(largest) < 5.0


def test_doing_nothing_is_zero_and_keeps_the_speed():
    road = parallel_env("interactive", normalised=True, overrides=FEW, seed=0)
    seen, _ = road.reset()
    speed = seen["changer_0"][0]
    after = road.step({name: np.zeros(2) for name in road.agents})[0]
    assert after["changer_0"][0] == pytest.approx(speed, abs=1e-6)
    space = road.action_space("changer_0")
    assert (space.low.tolist(), space.high.tolist()) == ([-1.0, -1.0], [1.0, 1.0])


def test_it_passes_pettingzoos_test_with_learned_followers():
    road = parallel_env("dense", normalised=True, learned_followers=True, overrides=FEW, seed=0)
    parallel_api_test(road, num_cycles=100_000)
