"""Where transitions are collected: the interface, and the collector of this process."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import Any, cast

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torchrl.collectors import Collector

from marl_lanes.envs.batched import LaneChangeEnv

WorkerState = Mapping[str, Tensor]
"""``roads``, a snapshot (bytes,) uint8; ``random``, torch's generator of a worker's process."""

OPTIONS: dict[str, Any] = {"track_traj_ids": False, "auto_register_policy_transforms": False}
"""What every collector over ``LaneChangeEnv`` needs."""


class WorkerError(RuntimeError):
    """A worker has died; the message names it."""


class TrafficCollector(ABC):
    """Batches of what a policy does on the roads.

    Attributes:
        policy: that drives; what is changed in it counts from the next batch on.
        places: of every worker, its process and host; empty where there are none.
        is_elsewhere: whether roads and policy are in workers or on a GPU, for which ``next`` waits.
    """

    policy: TensorDictModuleBase
    places: Sequence[str] = ()
    is_elsewhere: bool = False

    @abstractmethod
    def next(self) -> TensorDictBase:
        """The next batch, (E, T), or (N, E/N, T) of N workers.

        Raises:
            WorkerError: a worker has died.
        """

    @abstractmethod
    def state(self) -> list[WorkerState]:
        """Of every worker, what it needs to go on."""

    @abstractmethod
    def restore(self, states: Sequence[WorkerState]) -> None:
        """Go on from what an equal collector's ``state`` was.

        Raises:
            ValueError: it was that of another number of workers or roads.
        """

    @abstractmethod
    def shutdown(self) -> None:
        """End the workers."""


MakeCollector = Callable[[LaneChangeEnv, TensorDictModuleBase, int], TrafficCollector]
"""Makes a collector of an environment, a policy and the time steps of a batch. With workers the
environment is the pattern of theirs: each has as many roads."""


class LocalCollector(TrafficCollector):
    """Collects in this process.

    Its noise comes from torch's generator here, which is not part of its state.
    """

    def __init__(self, env: LaneChangeEnv, policy: TensorDictModuleBase, num_steps: int) -> None:
        self.env = env
        self.policy = policy
        self._collector = Collector(
            env,
            policy,
            frames_per_batch=env.simulator.num_envs * num_steps,
            total_frames=-1,
            **OPTIONS,
        )
        self._batches = iter(self._collector)

    def next(self) -> TensorDictBase:
        """The next batch, (E, T)."""
        return cast("TensorDictBase", next(self._batches))

    def state(self) -> list[WorkerState]:
        """The roads."""
        return [{"roads": take_roads(self.env)}]

    def restore(self, states: Sequence[WorkerState]) -> None:
        """Put the roads back."""
        (state,) = check_states(states, 1)
        self.env.restore(state["roads"].numpy().tobytes())
        # It has looked at its environment when it was built; let it look again.
        self._collector.reset()

    def shutdown(self) -> None:
        """Release the collector."""
        self._collector.shutdown()


def take_roads(env: LaneChangeEnv) -> Tensor:
    """The environment's roads, (bytes,) uint8."""
    return torch.frombuffer(bytearray(env.simulator.snapshot()), dtype=torch.uint8)


def check_states(states: Sequence[WorkerState], num_workers: int) -> Sequence[WorkerState]:
    """Refuse the states of another number of workers."""
    if len(states) != num_workers:
        raise ValueError(f"training state of {len(states)} workers: must be of {num_workers}")
    return states
