"""Roads in the computer's memory: their arrays, and the threads that advance them."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from marl_lanes.traffic.machine.compiled import entry_point
from marl_lanes.traffic.machine.state import State
from marl_lanes.traffic.machine.threads import RoadThreads
from marl_lanes.traffic.parameters import Parameters
from marl_lanes.traffic.step import RESET, SKIP, STEP, WARM_UP, run

Mask = NDArray[np.bool_]
Numbers = NDArray[np.floating[Any]]

_WORK_PER_CALL = 2**24
"""[vehicle slot steps] of a kernel call that takes many steps: about a second. Between two calls
Ctrl-C works."""


class HostRoads:
    """The roads that the processors advance.

    Args:
        state: empty roads.
        parameters: of their scenario.
        num_actions: D, numbers in an action.
        num_threads: threads that share the roads.
    """

    def __init__(
        self, state: State, parameters: Parameters, num_actions: int, num_threads: int
    ) -> None:
        self.state = state
        self.parameters = parameters
        shape = state.agents.shape
        self.actions = np.zeros((*shape, num_actions))
        self.follower_actions = np.zeros((*shape, 1))
        self._every_road = np.ones(shape[0], np.bool_)
        self._num_threads = num_threads
        self.steps_per_call = max(16, _WORK_PER_CALL // state.vehicles.size)
        """The most time steps of a call of ``skip``."""
        self._prepare()

    @property
    def tables(self) -> State:
        """What ``state`` is made of: the same arrays."""
        return self.state

    def _prepare(self) -> None:
        arrays = (*self.state.arrays, *self.parameters.arrays)
        self._arguments = (self.actions, self.follower_actions, *arrays)
        self._kernel: Callable[..., None] | None = None
        self._threads = RoadThreads(len(self._every_road), self._num_threads)

    def seed(self, seed: int, first_road: int) -> None:
        """Restart the random numbers; a road's stream is its index."""
        roads = self.state.roads
        roads["random_key"] = seed
        roads["random_stream"] = np.arange(len(roads)) + first_road
        roads["random_counter"] = 0

    def begin(self, mask: Mask | None) -> None:
        """Empty the masked roads, or all, and run their warm-up."""
        chosen = self._every_road if mask is None else mask
        # Nothing of the last episode remains, so equal seeds give equal bytes.
        state = self.state
        for array in (state.vehicles, state.agents, state.followers, state.collisions):
            array[chosen] = np.zeros((), array.dtype)
        state.order[chosen] = 0
        self._run(RESET, chosen, 0)
        while (state.roads["step"][chosen] < 0).any():
            self._run(WARM_UP, chosen, self.steps_per_call)

    def is_full(self, mask: Mask | None) -> bool:
        """Whether departures waited because ``max_vehicles`` were on a masked road."""
        waits = self.state.roads["num_held_back"]
        return bool((waits if mask is None else waits[mask]).any())

    def put(self, actions: Numbers | None, follower_actions: Numbers | None) -> None:
        """Set the actions of the next step; None: zeros."""
        if actions is None:
            self.actions.fill(0.0)
        else:
            np.copyto(self.actions, actions)
        if follower_actions is None:
            self.follower_actions.fill(0.0)
        else:
            np.copyto(self.follower_actions, follower_actions)

    def drive(self, answers: Sequence[tuple[Mask, Numbers]]) -> None:
        """Set the actions of the followers that policies drive: (E, A) bool, and their numbers."""
        for rows, accelerations in answers:
            self.follower_actions[rows, 0] = accelerations

    def step(self) -> None:
        """Advance every road by one time step."""
        self._run(STEP, self._every_road, 1)

    def skip(self, num_steps: int) -> None:
        """Advance each road without a live agent until it has one, or its episode is over."""
        self._run(SKIP, self._every_road, num_steps)

    def put_state(self, stored: State) -> None:
        """Set every byte of the roads."""
        for array, content in zip(self.state.arrays, stored.arrays, strict=True):
            np.copyto(array, content)

    def _run(self, mode: int, mask: Mask, num_steps: int) -> None:
        kernel = self._kernel
        num_roads = len(mask)
        if kernel is None:
            arguments = (0, num_roads, mode, num_steps, mask, *self._arguments)
            kernel = self._kernel = entry_point(run, arguments)
        if self._num_threads == 1:
            kernel(0, num_roads, mode, num_steps, mask, *self._arguments)
        else:
            self._threads.run(kernel, mode, num_steps, mask, *self._arguments)

    def __getstate__(self) -> dict[str, Any]:
        # A copy has its own threads, and the arguments must be the arrays of its state.
        own = ("_threads", "_kernel", "_arguments")
        return {name: value for name, value in self.__dict__.items() if name not in own}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._prepare()
