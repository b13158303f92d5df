"""What callers give, checked: whole numbers, flags, functions, arrays; refused in one line."""

import secrets
import sys
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from marl_lanes.scenario.messages import shown

_LAST_SEED = 2**64 - 1


def check_whole(name: str, value: object, low: int, high: int) -> int:
    """The value as an int.

    Raises:
        ValueError: it is no whole number from ``low`` to ``high``; a bool is none.
    """
    is_whole = isinstance(value, int | np.integer) and not isinstance(value, bool)
    if not is_whole or not low <= int(value) <= high:  # type: ignore[call-overload]
        last = high if high < 2**32 else f"2^{high.bit_length()} - 1"
        raise ValueError(f"{name} = {shown(value)}: must be a whole number, {low} to {last}")
    return int(value)  # type: ignore[call-overload, no-any-return]


def choose_seed(seed: int | None) -> int:
    """The seed, or one of 63 bits from the system's entropy.

    Raises:
        ValueError: it is no whole number from 0 to 2^64 - 1.
    """
    if seed is not None:
        return check_whole("seed", seed, 0, _LAST_SEED)
    return secrets.randbits(63)


def check_flag(name: str, value: object) -> bool:
    """The value as a bool.

    Raises:
        ValueError: it is neither True nor False.
    """
    if not isinstance(value, bool | np.bool_):
        raise ValueError(f"{name} = {shown(value)}: must be True or False")
    return bool(value)


def check_functions(name: str, given: object) -> None:
    """Refuse anything but None, or a mapping of names to functions.

    Raises:
        ValueError: it is something else.
    """
    if given is None:
        return
    if not isinstance(given, Mapping):
        raise ValueError(f"{name} = {shown(given)}: must be a mapping of names to functions")
    for key, function in given.items():
        if not isinstance(key, str) or not callable(function):
            raise ValueError(
                f"{name}[{shown(key)}] = {shown(function)}: must be a function, by its name"
            )


def read_numbers(name: str, given: object, shape: tuple[int, ...]) -> NDArray[np.floating[Any]]:
    """Floats as an array; not a copy where none is needed. They may be infinite or nan.

    Args:
        name: for the message.
        given: integers or floats of at most 64 bits: an array, nested sequences, a tensor.
        shape: that it must have.

    Raises:
        ValueError: it is something else.
    """
    # The common case first: it is read at every step.
    if type(given) is np.ndarray and given.dtype.char in "fd" and given.shape == shape:
        return given
    masked = sys.modules.get("numpy.ma")
    if masked is not None and isinstance(given, masked.MaskedArray):
        raise ValueError(f"{name}: must be ordinary numbers, is a masked array")
    array = _as_array(name, given, shape)
    if array.dtype.kind not in "fiu" or array.dtype.itemsize > 8:
        raise ValueError(
            f"{name} = {shown(given)}: must be real numbers of at most 64 bits, is of type "
            f"{array.dtype}"
        )
    return array if array.dtype.char in "fd" else array.astype(np.float64)


def read_mask(name: str, given: object, shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Truth values as a contiguous array.

    Raises:
        ValueError: it has another shape, or values other than True and False.
    """
    array = _as_array(name, given, shape)
    if array.dtype != np.bool_:
        raise ValueError(
            f"{name} = {shown(given)}: must be True or False, is of type {array.dtype}"
        )
    return np.ascontiguousarray(array)


def is_on_gpu(given: object) -> bool:
    """Whether it is an array in the memory of a GPU."""
    return hasattr(given, "__cuda_array_interface__")


def check_form(name: str, given: Any, shape: tuple[int, ...], kinds: str, device: str) -> None:
    """Refuse an array on a GPU of another shape or type, or on another GPU.

    Args:
        name: for the message.
        given: has ``__cuda_array_interface__``.
        shape: that it must have.
        kinds: the types that it may have, in numpy's characters.
        device: where it must be, cuda:N, as far as it tells where it is.

    Raises:
        ValueError: it is something else.
    """
    number = getattr(getattr(given, "device", None), "index", None)
    if number is not None and f"cuda:{number}" != device:
        raise ValueError(f"{name}: is on cuda:{number}, must be on {device}")
    form = given.__cuda_array_interface__
    if np.dtype(form["typestr"]).char not in kinds:
        raise ValueError(f"{name} = {shown(given)}: must not be of type {form['typestr']}")
    if tuple(form["shape"]) != shape:
        raise ValueError(f"{name}: shape {tuple(form['shape'])}, must be {shape}")


def _as_array(name: str, given: object, shape: tuple[int, ...]) -> NDArray[Any]:
    try:
        array = np.asarray(given)
    except (TypeError, ValueError, RuntimeError, OverflowError) as error:
        reason = str(error).partition("\n")[0]
        raise ValueError(
            f"{name} = {shown(given)}: must be an array of shape {shape}: {reason}"
        ) from None
    if array.shape != shape:
        raise ValueError(f"{name}: shape {array.shape}, must be {shape}")
    return array
