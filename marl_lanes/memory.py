"""Sizes that would not fit in memory are refused before anything is allocated."""

import psutil


def check_memory(
    name: str,
    value: float,
    needed: float,
    available: float | None = None,
    where: str = "memory",
) -> None:
    """Refuse a size that needs more memory than the machine has left.

    Args:
        name: of the field, for the message.
        value: its value, to which the memory is about proportional.
        needed: estimate of the memory for it [bytes].
        available: memory that is left [bytes]; by default the computer's.
        where: the memory is, for the message.

    Raises:
        ValueError: it needs more; the message says which value would fit.
    """
    if available is None:
        available = psutil.virtual_memory().available
    if needed > available:
        raise ValueError(
            f"{name} = {value}: needs about {needed / 2**30:.3g} GiB of {where}, "
            f"{available / 2**30:.3g} GiB are available; must be at most "
            f"{int(value * (available / needed))} here"
        )
