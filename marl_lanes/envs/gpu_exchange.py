"""What an environment gives to roads on a GPU and takes from them, in torch's tensors there."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase

from marl_lanes.envs.tensordict_internals import make_tensordict
from marl_lanes.envs.vehicle_table import state_bounds, state_columns
from marl_lanes.scenario.messages import shown
from marl_lanes.traffic.readout import changer_columns, follower_columns
from marl_lanes.traffic.roles.changer import CHANGER
from marl_lanes.traffic.roles.role import Role
from marl_lanes.traffic.simulator import Simulator

_ALIGNMENT = 16
"""[bytes] Every tensor begins at a multiple of it."""

_DTYPES = {
    np.dtype(np.bool_): torch.bool,
    np.dtype(np.float32): torch.float32,
    np.dtype(np.int64): torch.int64,
}


class Exchange:
    """Actions to the roads, and observations, rewards, masks and ends from them.

    Kernels write all of them to one piece of memory, which is then copied: what a step returns
    belongs to the caller. Nothing waits for the GPU, so a step may be part of a CUDA graph.

    Args:
        simulator: its roads are on the GPU.
        device: torch's, the same GPU.
        roles: whose agents act.
        has_state: whether there is a table of the vehicles.
    """

    def __init__(
        self, simulator: Simulator, device: torch.device, roles: Sequence[Role], has_state: bool
    ) -> None:
        self._given = (simulator, device, tuple(roles), has_state)
        self._roads = simulator.gpu_roads
        self._roles = tuple(roles)
        self.device = device
        roads, flat = self._roads, (simulator.num_envs, simulator.num_slots)
        self._shape = torch.Size(flat)
        self._actions = {
            role.group: torch.as_tensor(there, device=device)
            for role, there in zip(
                roles, (roads.actions_there, roads.follower_actions_there), strict=False
            )
        }
        self._observations = {
            role.group: torch.as_tensor(getattr(roads.tables, role.observations), device=device)
            for role in roles
        }
        self._places: list[tuple[slice, tuple[int, ...], torch.dtype]] = []
        self._columns: dict[str, dict[str, Any]] = {
            role.group: (changer_columns if role is CHANGER else follower_columns)(flat, self._add)
            for role in roles
        }
        self._ends = {
            name: self._add((flat[0], 1), np.bool_) for name in ("done", "terminated", "truncated")
        }
        rows = (flat[0], simulator.scenario.max_vehicles, len(state_columns(simulator.scenario)))
        self._tables = {"state": self._add(rows, np.float32)} if has_state else {}
        bounds = state_bounds(simulator.scenario, simulator.num_slots)
        self._table_bounds = [torch.tensor(bound, device=device) for bound in bounds]
        self._memory = torch.empty(self._size, dtype=torch.uint8, device=device)
        arrays = [roads.share(one) for one in self._divide(self._memory)]
        ends = [arrays[number] for number in self._ends.values()]
        self._readouts = [
            *(self._make_readout(role, arrays, ends) for role in roles),
            *(roads.make_table_readout(arrays[number]) for number in self._tables.values()),
        ]
        # The roads were made on the default stream, and torch's may go ahead of it.
        roads.check(wait=True)

    def _make_readout(
        self, role: Role, arrays: Sequence[Any], ends: Sequence[Any]
    ) -> Callable[[], None]:
        columns = {key: arrays[number] for key, number in self._columns[role.group].items()}
        if role is CHANGER:
            return self._roads.make_readout(columns, ends)
        return self._roads.make_follower_readout(columns)

    def __reduce__(self) -> tuple[Any, ...]:
        """A copy shares the memory of its own roads."""
        return Exchange, self._given

    @property
    def _size(self) -> int:
        return self._places[-1][0].stop if self._places else 0

    def _add(self, shape: tuple[int, ...], dtype: Any) -> int:
        """A tensor's number in the memory."""
        kind = np.dtype(dtype)
        start = -(-self._size // _ALIGNMENT) * _ALIGNMENT
        stop = start + kind.itemsize * int(np.prod(shape))
        self._places.append((slice(start, stop), shape, _DTYPES[kind]))
        return len(self._places) - 1

    def _divide(self, memory: torch.Tensor) -> list[torch.Tensor]:
        return [memory[place].view(dtype).view(shape) for place, shape, dtype in self._places]

    def stream(self) -> Any:
        """A block in which the roads' kernels are on torch's present stream."""
        return self._roads.on_stream(torch.cuda.current_stream(self.device).cuda_stream)

    def put(self, tensordict: TensorDictBase) -> None:
        """Set the actions of the next step.

        Raises:
            ValueError: one is missing, or of another type or shape; or an earlier one was refused.
        """
        given = [(role.group, tensordict.get((role.group, "action"), None)) for role in self._roles]
        for group, action in given:
            kept = self._actions[group]
            if not isinstance(action, torch.Tensor):
                raise ValueError(f"action of the group {group!r}: must be given")
            if action.dtype is torch.bool or action.dtype.is_complex:
                raise ValueError(
                    f"action of the group {group!r}: must be real numbers, is {action.dtype}"
                )
            if action.shape != kept.shape:
                raise ValueError(
                    f"action of the group {group!r}: shape {tuple(action.shape)}, must be "
                    f"{tuple(kept.shape)}"
                )
        for group, action in given:
            self._actions[group].copy_(action.detach())
        self._roads.check_actions()

    def read(self, device: torch.device | None, *, is_start: bool = False) -> TensorDict:
        """New tensors of what the roads give.

        Args:
            device: of the result.
            is_start: without rewards and ends, as after a reset.
        """
        for readout in self._readouts:
            readout()
        tensors = self._divide(self._memory.clone())
        for number in self._tables.values():
            tensors[number].clamp_(*self._table_bounds)
        left_out = ("reward", *self._ends) if is_start else ()
        made: dict[str, Any] = {}
        for group, columns in self._columns.items():
            read = {key: tensors[one] for key, one in columns.items() if key not in left_out}
            read["observation"] = self._observations[group].clone()
            made[group] = make_tensordict(read, self._shape, self.device)
        root = self._tables if is_start else self._ends | self._tables
        made |= {key: tensors[number] for key, number in root.items()}
        result = make_tensordict(made, self._shape[:1], self.device)
        return result if device == self.device else result.to(device)


def check_device(device: torch.device | str) -> torch.device:
    """The device, if tensors can be moved to it."""
    try:
        chosen = torch.device(device)
        # With its number, as tensors there have it.
        moved = torch.zeros(1, device="cpu").to(chosen)
        moved.cpu()
    except (AssertionError, RuntimeError, TypeError) as error:
        reason = str(error).partition("\n")[0]
        raise ValueError(
            f"device = {shown(device)}: must be cpu, or a device that is here: {reason}"
        ) from None
    return moved.device
