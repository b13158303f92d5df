"""Sizes that would not fit in memory are refused before anything is allocated."""

import psutil


def check_memory(name: str, value: float, needed: float) -> None:
    """Refuse a size that needs more memory than the machine has left.

    Args:
        name: of the field, for the message.
        value: its value, to which the memory is about proportional.
        needed: estimate of the memory for it [bytes].

    Raises:
        ValueError: it needs more; the message says which value would fit.
    """
    available = psutil.virtual_memory().available
    if needed > available:
        raise ValueError(
            f"{name} = {value}: needs about {needed / 2**30:.3g} GiB of memory, "
            f"{available / 2**30:.3g} GiB are available; must be at most "
            f"{int(value * (available / needed))} here"
        )
