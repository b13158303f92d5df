"""The random numbers: known answers, uniformity, independence of the streams."""

import numpy as np
import philox as reference
import pytest

from marl_lanes.traffic.machine.random import choice, philox, uniform
from marl_lanes.traffic.simulator import Simulator

# Random123's kat_vectors, philox4x32 10: counter, key, answer.
KNOWN_ANSWERS = [
    ((0, 0, 0, 0), (0, 0), (0x6627E8D5, 0xE169C58D, 0xBC57AC4C, 0x9B00DBD8)),
    (
        (0xFFFFFFFF,) * 4,
        (0xFFFFFFFF,) * 2,
        (0x408F276D, 0x41C83B0E, 0xA20BC7C6, 0x6D5451FD),
    ),
    (
        (0x243F6A88, 0x85A308D3, 0x13198A2E, 0x03707344),
        (0xA4093822, 0x299F31D0),
        (0xD16CFE09, 0x94FDCCEB, 0x5001E420, 0x24126EA1),
    ),
]


def pairs(words):
    """32-bit words, low first, as 64-bit ones."""
    return [
        np.uint64(low + (high << 32)) for low, high in zip(words[::2], words[1::2], strict=True)
    ]


def draws(count, *, seed=0, stream=0):
    road = Simulator("paper", stream + 1, seed=seed).roads[stream]
    return np.array([uniform(road, 0.0, 1.0) for _ in range(count)])


@pytest.mark.parametrize(("counter", "key", "answer"), KNOWN_ANSWERS)
def test_known_answers(counter, key, answer):
    assert list(philox(*pairs(counter), *pairs(key))) == pairs(answer)
    assert tuple(reference.philox(counter, key)) == answer


def test_uniform_takes_the_upper_53_bits_of_the_low_words_and_counts():
    simulator = Simulator("paper", 4, seed=2**64 - 5)
    road = simulator.roads[3]
    oracle = reference.Random(2**64 - 5, 3, 0)
    for low, high in ((0.0, 1.0), (-3.0, 7.5), (2.0, 2.0)):
        assert uniform(road, low, high) == oracle.uniform(low, high)
    assert simulator.roads["random_counter"].tolist() == [0, 0, 0, 3]
    assert uniform(road, 2.0, 2.0) == 2.0


def test_uniform_numbers_fill_the_unit_interval_evenly():
    numbers = draws(40_000)
    assert numbers.min() >= 0.0
    assert numbers.max() < 1.0
    counts = np.histogram(numbers, 40, (0.0, 1.0))[0]
    # 39 degrees of freedom: 72 is the 0.1 % point.
    assert ((counts - 1000.0) ** 2 / 1000.0).sum() < 72.0
    assert abs(np.corrcoef(numbers[:-1], numbers[1:])[0, 1]) < 0.02


def test_streams_and_seeds_are_unrelated():
    first = draws(4000)
    for other in (draws(4000, stream=1), draws(4000, seed=1), draws(4000, seed=2**63)):
        assert len(np.intersect1d(first, other)) == 0
        assert abs(np.corrcoef(first, other)[0, 1]) < 0.05


def test_choice_follows_the_shares():
    road = Simulator("paper", seed=0).roads[0]
    cumulative = np.array([0.2, 0.2, 0.9, 1.0])
    counts = np.bincount([choice(road, cumulative) for _ in range(10_000)], minlength=4)
    assert counts[1] == 0
    assert counts / 10_000 == pytest.approx([0.2, 0.0, 0.7, 0.1], abs=0.02)
