"""How many kernels an update of NAF launches on a GPU, counted without one."""

import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from typing import Any
from unittest.mock import patch

import torch
from torch import Tensor
from torch._inductor.utils import run_and_get_code
from torch.utils._python_dispatch import TorchDispatchMode

from marl_lanes.training import graphs
from marl_lanes.training.algorithms.naf import NAF
from marl_lanes.training.learner import Learner
from marl_lanes.training.replay import ROWS_AT_ONCE

GROUPS = ("drawing", "forward", "backward", "optimiser", "target")
_ALLOCATIONS = ("empty", "empty_like", "empty_strided", "new_empty", "new_empty_strided")
_COMPILED_KERNEL = re.compile(
    # A loop of a C++ kernel is a kernel of its own on a GPU.
    r"^ +(?:for\(int64_t x0=|(?:\w+ = )?(?:extern_kernels|torch\.ops|aten)\.)",
    re.MULTILINE,
)


class KernelCounter(TorchDispatchMode):  # type: ignore[no-untyped-call]
    """Counts the operators that launch a kernel, by what they are for: those that are no views.

    A few launch two on a GPU, such as a product that adds a bias to all rows.
    """

    def __init__(self) -> None:
        super().__init__()  # type: ignore[no-untyped-call]
        self.group = "drawing"
        self.counts = Counter[str]()

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        name = func.overloadpacket.__name__
        if func.namespace == "aten" and not func.is_view and name not in _ALLOCATIONS:
            self.counts[self.group] += 1
        return func(*args, **(kwargs or {}))

    @contextmanager
    def during(self, target: Any, name: str, group: str) -> Iterator[None]:
        """Count what a method does for a group."""
        method: Callable[..., Any] = getattr(target, name)

        def counted(*args: Any, **kwargs: Any) -> Any:
            before, self.group = self.group, group
            try:
                return method(*args, **kwargs)
            finally:
                self.group = before

        with patch.object(target, name, counted):
            yield


def count_kernels(learner: Learner) -> dict[str, float]:
    """Kernels of one update by group, as if it were a graph on a GPU; a mean over one draw.

    Drawing includes what brings a batch to the graph, and the loss from it.
    """
    algorithm = _as_graphs(learner)
    number = ROWS_AT_ONCE // algorithm.config.replay.batch_size
    counter = KernelCounter()
    with patch.object(graphs, "capture", lambda function: function), ExitStack() as stack:
        learner.update(number)
        for target, name, group in (
            (algorithm, "compute_loss", "forward"),
            (algorithm, "_differentiate", "backward"),
            (algorithm, "_step", "optimiser"),
            (algorithm.target_updater, "step", "target"),
        ):
            stack.enter_context(counter.during(target, name, group))
        with counter:
            learner.update(number)
    return {group: counter.counts[group] / number for group in GROUPS}


def count_compiled_kernels(learner: Learner) -> Mapping[str, int]:
    """Kernels of a compiled loss, forward and backward, as torch.compile makes them for the CPU.

    For a GPU it makes fewer: there it writes one kernel for tensors that are put side by side.
    """

    def update() -> dict[str, Tensor]:
        return learner.update(1)

    torch.compiler.reset()
    _, code = run_and_get_code(update)
    counts = [len(_COMPILED_KERNEL.findall(one)) for one in code]
    return dict(zip(("forward", "backward"), counts, strict=True))


def _as_graphs(learner: Learner) -> NAF:
    """The learner's algorithm; its updates become graphs, and read what is set here."""
    algorithm = learner.algorithm
    if not isinstance(algorithm, NAF):
        raise TypeError(f"algorithm: must be NAF, got {type(algorithm).__name__}")
    algorithm.is_graphed = True
    algorithm.anneal(algorithm.pretraining_transitions)
    return algorithm


def print_kernels(rows: Mapping[str, Mapping[str, float]]) -> None:
    """One line for each kind of update."""
    print(f"{'kernels of an update':24}", *(f"{group:>9}" for group in GROUPS), f"{'all':>7}")
    for name, counts in rows.items():
        numbers = (f"{counts[group]:9.1f}" for group in GROUPS)
        print(f"{name:24}", *numbers, f"{sum(counts.values()):7.1f}")
