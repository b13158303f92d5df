"""Roads on a GPU: their arrays in its memory, and the launches of the kernels that change them."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from typing import Any

import numpy as np
from numba import cuda
from numpy.typing import NDArray

from marl_lanes.scenario.messages import shown
from marl_lanes.traffic import gpu_kernels as kernels
from marl_lanes.traffic.arguments import is_on_gpu
from marl_lanes.traffic.gpu_memory import DeviceArray, FetchedState, empty, words
from marl_lanes.traffic.host import Mask, Numbers
from marl_lanes.traffic.machine.launches import Block, Launch, configure
from marl_lanes.traffic.machine.state import State
from marl_lanes.traffic.machine.team import MOST_MEMBERS, TEAM_SIZES
from marl_lanes.traffic.parameters import Parameters
from marl_lanes.traffic.step import RESET, SKIP, STEP, WARM_UP

_BLOCK = (128,)
"""Threads of a block of the kernels that go through an array."""

_GROUPS = kernels.GROUPS_AT_WORK * 132
"""Groups of threads that an H100, with 132 processors, has at work at once."""

_FEWEST_MEMBERS = 8
"""Of a team: about half as many as there are vehicles on a road of the scenario ``paper``."""

_STEPS_PER_CALL = 256
"""Time steps of a launch that takes many. Between two launches Ctrl-C works."""


class GpuRoads:
    """The roads that a GPU advances, a team of threads each, on a stream of the caller's.

    Nothing waits for the GPU but what gives numbers to the host.

    Args:
        road: an empty road, for all.
        parameters: of the scenario.
        num_roads: E.
        num_actions: D, numbers in an action.
        learner: ``policy`` of the followers that a learner drives; one that none has if there are
            none.
        gpu: its number.
    """

    def __init__(
        self,
        road: State,
        parameters: Parameters,
        num_roads: int,
        *,
        num_actions: int,
        learner: int,
        gpu: int,
    ) -> None:
        self._gpu, self._learner, self._handle = gpu, learner, 0
        self._allocate(road, parameters, num_roads, num_actions)
        for table, row in zip(self.tables.arrays, road.arrays, strict=True):
            self._fill(table, row)

    def _allocate(
        self, road: State, parameters: Parameters, num_roads: int, num_actions: int
    ) -> None:
        self.parameters = parameters
        self._kept: dict[bytes, DeviceArray] = {}
        with cuda.gpus[self._gpu]:
            self.tables = State(
                *(empty((num_roads, *array.shape[1:]), array.dtype) for array in road.arrays)
            )
            flat = (num_roads, road.agents.shape[1])
            self.actions_there = cuda.to_device(np.zeros((*flat, num_actions)))
            """(E, A, D) float64 on the GPU: of the next step. ``check_actions`` once it is set."""
            self.follower_actions_there = cuda.to_device(np.zeros((*flat, 1)))
            """(E, A, 1) float64, likewise."""
            self._constants = [cuda.to_device(array) for array in parameters.arrays]
            self._every_road = cuda.to_device(np.ones(num_roads, np.bool_))
            self._mask = cuda.to_device(np.ones(num_roads, np.bool_))
            self._refused = cuda.to_device(np.zeros(1, np.int64))
            self._alarms = cuda.mapped_array(2, np.int64)
        self._alarms[:] = 0
        # A road without num_agents or a horizon is still driven for at most so long before it.
        warmup = parameters.constants[0]["warmup_high"] / parameters.constants[0]["time_step"]
        self._warmup_steps = math.ceil(warmup)
        self.form_teams(_choose_team(num_roads))

    def form_teams(self, size: int) -> None:
        """Let so many threads advance a road: 1 to 32, a power of two. Only the time depends on it.

        By default as many as there is room for, but not fewer than 8.

        Raises:
            ValueError: it is another number.
        """
        if size not in TEAM_SIZES:
            raise ValueError(f"size = {shown(size)}: must be one of {TEAM_SIZES}")
        self.team_size = size
        # Small blocks: few roads are spread over all processors.
        self._block = (size, MOST_MEMBERS // size)
        self._prepare()

    def _prepare(self) -> None:
        """What every step launches."""
        actions, behind, tables = self.actions_there, self.follower_actions_there, self.tables
        alarms = self._refused, self._alarms
        step = self._advance_arguments(STEP, self._every_road, 1)
        self._step = Launch(kernels.advance, len(self._every_road), step, self._block)
        has_longitudinal = actions.shape[2] > 1
        check = (actions, tables.agents, has_longitudinal, *alarms)
        self._check = Launch(kernels.check_actions, actions.size, check, _BLOCK)
        check = (behind, tables.followers, self._learner, *alarms)
        self._check_followers = Launch(kernels.check_follower_actions, behind.size, check, _BLOCK)

    @property
    def state(self) -> FetchedState:
        """What reads the tables; made anew, for in a circle the GPU's memory is freed late."""
        return FetchedState(self)

    @property
    def actions(self) -> NDArray[np.float64]:
        """A copy of (E, A, D) of the last step."""
        return self.fetch(self.actions_there)

    @property
    def follower_actions(self) -> NDArray[np.float64]:
        """A copy of (E, A, 1) of the last step."""
        return self.fetch(self.follower_actions_there)

    @property
    def steps_per_call(self) -> int:
        """The most time steps of a call of ``skip``."""
        return _STEPS_PER_CALL

    @contextmanager
    def on_stream(self, handle: int) -> Iterator[None]:
        """Launch on this stream of the GPU inside the block; outside it, on the default stream."""
        self._handle = handle
        try:
            yield
        finally:
            self._handle = 0

    def share(self, array: object) -> DeviceArray:
        """An array of numba-cuda in the memory of another library's."""
        with cuda.gpus[self._gpu]:
            return cuda.as_cuda_array(array)

    def fetch(self, array: DeviceArray) -> NDArray[Any]:
        """A read-only copy of an array, after all work of the GPU.

        Raises:
            ValueError: an action was refused.
        """
        self.check(wait=True)
        with cuda.gpus[self._gpu]:
            found: NDArray[Any] = array.copy_to_host()
        found.flags.writeable = False
        return found

    def _send(self, content: NDArray[Any], array: DeviceArray) -> None:
        """Copy to the GPU, on whichever stream its work before and after this is."""
        with cuda.gpus[self._gpu]:
            cuda.synchronize()
            array.copy_to_device(content)
            cuda.synchronize()

    def check(self, *, wait: bool) -> None:
        """Report an action that a kernel refused; from then on the roads were left as they are.

        Args:
            wait: for all work of the GPU; without it an action is found that was refused so far.

        Raises:
            ValueError: an action of an acting agent is not finite.
        """
        if wait:
            with cuda.gpus[self._gpu]:
                cuda.synchronize()
        number = int(self._alarms[kernels.REFUSED])
        if number == 0:
            return
        self._send(np.zeros(1, np.int64), self._refused)
        self._alarms[kernels.REFUSED] = 0
        name = "actions" if number > 0 else "follower_actions"
        shape = (self.actions_there if number > 0 else self.follower_actions_there).shape
        env, slot, column = (int(one) for one in np.unravel_index(abs(number) - 1, shape))
        raise ValueError(
            f"{name}[{env}, {slot}, {column}]: must be a finite acceleration; the steps after it "
            "were not taken"
        )

    def seed(self, seed: int, first_road: int) -> None:
        """Restart the random numbers; a road's stream is its index.

        Raises:
            ValueError: an action was refused.
        """
        self.check(wait=True)
        numbers = np.uint64(seed), np.uint64(first_road)
        self._launch(kernels.seed_roads, len(self._every_road), self.tables.roads, *numbers)

    def begin(self, mask: Mask | DeviceArray | None) -> None:
        """Empty the masked roads, or all, and run their warm-up.

        Raises:
            ValueError: an earlier action was refused, see ``check``.
        """
        self.check(wait=False)
        chosen = self._put_mask(mask)
        tables = self.tables
        for table in (tables.vehicles, tables.agents, tables.followers, tables.collisions):
            self._fill(table, np.zeros((1, *table.shape[1:]), table.dtype), chosen)
        self._fill(tables.order, np.zeros((1, *tables.order.shape[1:]), np.uint32), chosen)
        self._run(RESET, chosen, 0)
        for begun in range(0, self._warmup_steps, _STEPS_PER_CALL):
            self._run(WARM_UP, chosen, min(_STEPS_PER_CALL, self._warmup_steps - begun))

    def is_full(self, mask: Mask | DeviceArray | None) -> bool:
        """Whether departures waited on a masked road, as far as it is known without waiting."""
        chosen = self._put_mask(mask)
        roads = self.tables.roads
        self._launch(kernels.look_for_full_roads, len(chosen), chosen, roads, self._alarms)
        return bool(self._alarms[kernels.IS_FULL])

    def put(
        self, actions: Numbers | DeviceArray | None, follower_actions: Numbers | DeviceArray | None
    ) -> None:
        """Set the actions of the next step; None: zeros.

        Raises:
            ValueError: an earlier action was refused, see ``check``.
        """
        self.check(wait=False)
        pairs = (actions, self.actions_there), (follower_actions, self.follower_actions_there)
        for given, kept in pairs:
            if is_on_gpu(given):
                self._launch(kernels.copy_numbers, kept.size, self.share(given), kept)
                continue
            if given is None:
                self._fill(kept, np.zeros((1, *kept.shape[1:])))
            else:
                self._send(np.array(given, np.float64), kept)
        if any(is_on_gpu(given) for given, _ in pairs):
            self.check_actions()

    def check_actions(self) -> None:
        """Look for actions that are not finite, on the GPU.

        Raises:
            ValueError: an earlier action was refused, see ``check``.
        """
        self.check(wait=False)
        self._repeat(self._check)
        if self.parameters.constants[0]["num_external"] > 0:
            self._repeat(self._check_followers)

    def drive(self, answers: Sequence[tuple[Mask, Numbers]]) -> None:
        """Set the actions of the followers that policies drive: (E, A) bool, and their numbers."""
        if not answers:
            return
        actions = self.follower_actions.copy()
        for rows, accelerations in answers:
            actions[rows, 0] = accelerations
        self._send(actions, self.follower_actions_there)

    def step(self) -> None:
        """Advance every road by one time step: one launch."""
        self._repeat(self._step)

    def skip(self, num_steps: int) -> None:
        """Advance each road without a live agent until it has one, or its episode is over."""
        self._run(SKIP, self._every_road, num_steps)

    def put_state(self, stored: State) -> None:
        """Set every byte of the roads.

        Raises:
            ValueError: an action was refused.
        """
        self.check(wait=True)
        for array, content in zip(self.tables.arrays, stored.arrays, strict=True):
            if content.size > 0:
                self._send(content.copy(), array)

    def make_readout(
        self, columns: Mapping[str, DeviceArray], ends: Sequence[DeviceArray]
    ) -> Callable[[], None]:
        """What fills ``changer_columns``, and the roads' ends, three (E, 1) bool."""
        agents, roads = self.tables.agents, self.tables.roads
        has_longitudinal = self.actions_there.shape[2] > 1
        given = (agents, has_longitudinal, *columns.values(), roads, *ends)
        return self._make_repeated(kernels.read_changers, agents.size, given)

    def make_follower_readout(self, columns: Mapping[str, DeviceArray]) -> Callable[[], None]:
        """What fills ``follower_columns``."""
        agents, followers = self.tables.agents, self.tables.followers
        given = (agents, followers, self._learner, *columns.values())
        return self._make_repeated(kernels.read_followers, agents.size, given)

    def make_table_readout(self, rows: DeviceArray) -> Callable[[], None]:
        """What fills (E, V, columns) float32 as ``read_vehicle_tables`` does."""
        tables = self.tables
        _, profiles, *_ = self._constants
        given = (tables.roads, tables.order, tables.vehicles, tables.agents, profiles, rows)
        return self._make_repeated(kernels.read_vehicles, tables.order.size, given)

    def _make_repeated(
        self, kernel: Callable[..., None], number: int, given: tuple[Any, ...]
    ) -> Callable[[], None]:
        return partial(self._repeat, Launch(kernel, number, given, _BLOCK))

    def _run(self, mode: int, mask: DeviceArray, num_steps: int) -> None:
        given = self._advance_arguments(mode, mask, num_steps)
        self._launch(kernels.advance, len(mask), *given, block=self._block)

    def _advance_arguments(self, mode: int, mask: DeviceArray, num_steps: int) -> tuple[Any, ...]:
        actions = self.actions_there, self.follower_actions_there
        numbers = np.int64(mode), np.int64(num_steps)
        return (*numbers, self._refused, mask, *actions, *self.tables.arrays, *self._constants)

    def _fill(self, table: DeviceArray, row: NDArray[Any], mask: DeviceArray | None = None) -> None:
        """Set the masked roads of a table, or all, to the row of one road."""
        chosen = self._every_road if mask is None else mask
        rows, content = words(table), words(row)[0]
        if rows.size > 0:
            given = self._refused, chosen, rows, self._there(content)
            self._launch(kernels.fill_rows, rows.size, *given)

    def _there(self, content: NDArray[Any]) -> DeviceArray:
        """A small array on the GPU, copied there once."""
        key = content.tobytes()
        if key not in self._kept:
            with cuda.gpus[self._gpu]:
                self._kept[key] = cuda.to_device(content)
                # Whichever stream reads it.
                cuda.synchronize()
        return self._kept[key]

    def _put_mask(self, mask: Mask | DeviceArray | None) -> DeviceArray:
        if mask is None:
            return self._every_road
        if is_on_gpu(mask):
            return self.share(mask)
        self._send(mask, self._mask)
        return self._mask

    def _launch(
        self, kernel: Callable[..., None], number: int, *given: Any, block: Block = _BLOCK
    ) -> None:
        with cuda.gpus[self._gpu]:
            configure(kernel, number, block, self._handle)(*given)

    def _repeat(self, launch: Launch) -> None:
        with cuda.gpus[self._gpu]:
            launch(self._handle)

    def __getstate__(self) -> dict[str, Any]:
        return {
            "gpu": self._gpu,
            "learner": self._learner,
            "state": State(*self.state.arrays),
            "parameters": self.parameters,
            "actions": self.actions,
            "follower_actions": self.follower_actions,
        }

    def __setstate__(self, kept: dict[str, Any]) -> None:
        self._gpu, self._learner, self._handle = kept["gpu"], kept["learner"], 0
        state, actions = kept["state"], kept["actions"]
        self._allocate(state, kept["parameters"], len(state.roads), actions.shape[-1])
        self.put_state(state)
        self.put(actions, kept["follower_actions"])


def _choose_team(num_roads: int) -> int:
    """Members of a road's team: as many as there are threads for that are at work at once."""
    size = MOST_MEMBERS
    while size > _FEWEST_MEMBERS and num_roads * size > _GROUPS * MOST_MEMBERS:
        size //= 2
    return size
