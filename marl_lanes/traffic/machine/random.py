"""Counter-based random numbers: Philox4x32-10, one stream for each road.

The n-th number of a road is a pure function of (seed, stream, n). So it does not depend on
threads or on the number of roads.

Source: Salmon, Moraes, Dror, Shaw 2011, "Parallel random numbers: as easy as 1, 2, 3".
"""

from typing import Any

import numpy as np

from marl_lanes.traffic.machine.compiled import compiled

_MULTIPLIER_0 = np.uint64(0xD2511F53)
_MULTIPLIER_1 = np.uint64(0xCD9E8D57)
_WEYL_0 = np.uint64(0x9E3779B9)
_WEYL_1 = np.uint64(0xBB67AE85)
_MASK = np.uint64(0xFFFFFFFF)
_SHIFT = np.uint64(32)
_DROP = np.uint64(11)
_UNIT = 1.0 / 9007199254740992.0  # 2^-53


@compiled
def philox(counter: np.uint64, stream: np.uint64, key: np.uint64) -> tuple[np.uint64, np.uint64]:
    """Philox4x32-10 of the 128-bit counter (counter, stream) under a 64-bit key.

    Args:
        counter: low 64 bits of the counter, uint64.
        stream: high 64 bits of the counter, uint64.
        key: uint64.

    Returns:
        The 128 random bits as two uint64, low words first.
    """
    word_0 = counter & _MASK
    word_1 = counter >> _SHIFT
    word_2 = stream & _MASK
    word_3 = stream >> _SHIFT
    key_0 = key & _MASK
    key_1 = key >> _SHIFT
    for _ in range(10):
        product_0 = _MULTIPLIER_0 * word_0
        product_1 = _MULTIPLIER_1 * word_2
        word_0 = (product_1 >> _SHIFT) ^ word_1 ^ key_0
        word_1 = product_1 & _MASK
        word_2 = (product_0 >> _SHIFT) ^ word_3 ^ key_1
        word_3 = product_0 & _MASK
        key_0 = (key_0 + _WEYL_0) & _MASK
        key_1 = (key_1 + _WEYL_1) & _MASK
    return word_0 | (word_1 << _SHIFT), word_2 | (word_3 << _SHIFT)


@compiled
def uniform(road: Any, low: float, high: float) -> float:
    """The road's next number, uniform in [low, high); low if both are equal."""
    bits, _ = philox(road.random_counter, road.random_stream, road.random_key)
    road.random_counter = road.random_counter + np.uint64(1)
    return low + (high - low) * (float(bits >> _DROP) * _UNIT)


@compiled
def choice(road: Any, cumulative: Any) -> int:
    """The road's next random index; ``cumulative`` is (K,) cumulative shares, the last is 1."""
    draw = uniform(road, 0.0, 1.0)
    index = 0
    while index < cumulative.shape[0] - 1 and draw >= cumulative[index]:
        index += 1
    return index
