"""Roads divided among threads, also in a forked process; one call at a time."""

import os
import sys
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor, wait
from functools import wraps
from itertools import pairwise
from typing import Any, TypeVar, cast

import numpy as np

Method = TypeVar("Method", bound=Callable[..., Any])


def count_processors() -> int:
    """Processors that this process may use."""
    if sys.version_info >= (3, 13):
        return os.process_cpu_count() or 1
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def exclusive(method: Method) -> Method:
    """Refuse a call while another one is in progress: both would write to the same roads.

    The object has a ``threading.Lock`` as ``_lock``.

    Raises:
        RuntimeError: another call is in progress.
    """

    @wraps(method)
    def checked(self: Any, *arguments: Any, **options: Any) -> Any:
        if not self._lock.acquire(blocking=False):
            raise RuntimeError(
                f"{method.__qualname__}: another call is in progress: in another thread, of a "
                "follower's policy, or when this process was forked; use a copy (copy.deepcopy)"
            )
        try:
            return method(self, *arguments, **options)
        finally:
            self._lock.release()

    return cast("Method", checked)


class RoadThreads:
    """Threads that each advance a range of roads.

    Args:
        num_roads: to be divided, >= 1.
        num_threads: 1 to num_roads; the calling thread is one of them.
    """

    def __init__(self, num_roads: int, num_threads: int) -> None:
        bounds = np.linspace(0, num_roads, num_threads + 1).astype(int).tolist()
        self._ranges = list(pairwise(bounds))
        self._pool: ThreadPoolExecutor | None = None
        self._pending: list[Future[None]] = []
        self._process = 0

    def run(self, kernel: Callable[..., None], *arguments: Any) -> None:
        """Call ``kernel(start, stop, *arguments)`` for all ranges, and wait for the last."""
        (first, *others) = self._ranges
        if not others:
            kernel(*first, *arguments)
            return
        if self._pool is None or self._process != os.getpid():
            # A forked process has a copy of the pool, but none of its threads.
            self._process = os.getpid()
            self._pool, self._pending = ThreadPoolExecutor(len(others), "marl_lanes"), []
        # After an interruption threads may still be at work on these roads.
        wait(self._pending)
        self._pending = []
        for part in others:
            self._pending.append(self._pool.submit(kernel, *part, *arguments))
        kernel(*first, *arguments)
        for future in self._pending:
            future.result()
