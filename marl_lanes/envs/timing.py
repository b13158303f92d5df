"""The wall time of an environment's steps and resets, which also work in a forked process."""

import os
import time
from collections.abc import Callable
from functools import cache, wraps
from typing import Any

import torch
from tensordict import TensorDict

_PROCESS = os.getpid()
"""The process that imported this module: another one was forked from it."""


@cache
def _prepare_torch(process: int) -> None:
    """In a forked process torch's threads are gone: it would wait for them for ever."""
    if process != _PROCESS:
        torch.set_num_threads(1)


def timed(method: Callable[..., TensorDict]) -> Callable[..., TensorDict]:
    """Add the wall time of each call to the environment's ``seconds``; works after a fork."""

    @wraps(method)
    def measured(self: Any, *args: Any, **kwargs: Any) -> TensorDict:
        _prepare_torch(os.getpid())
        start = time.perf_counter()
        result = method(self, *args, **kwargs)
        self.seconds += time.perf_counter() - start
        return result

    return measured
