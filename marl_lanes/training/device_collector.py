"""Where transitions are collected on the device on which the roads are."""

from collections.abc import Sequence

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torchrl.envs.utils import ExplorationType, set_exploration_type

from marl_lanes.envs.batched import LaneChangeEnv
from marl_lanes.training.collectors import (
    TrafficCollector,
    WorkerState,
    check_states,
    take_roads,
)
from marl_lanes.training.graphs import Graphed


class DeviceCollector(TrafficCollector):
    """Collects without waiting for the device: TorchRL's collector asks after every step who ended.

    On a GPU a batch of steps is one CUDA graph. Noise comes from torch's generator of the device,
    which is not part of the state.

    Args:
        env: whose episodes never end.
        policy: on the environment's device; it waits for nothing there.
        num_steps: time steps of a batch.
        is_graphed: whether all that env and policy do in a step is done on a GPU.
    """

    is_elsewhere = True

    def __init__(
        self,
        env: LaneChangeEnv,
        policy: TensorDictModuleBase,
        num_steps: int,
        *,
        is_graphed: bool = False,
    ) -> None:
        self.env = env
        self.policy = policy
        self.num_steps = num_steps
        self._drive = Graphed(self._take_steps) if is_graphed else self._take_steps
        self._now = env.reset()

    def next(self) -> TensorDictBase:
        """The next batch, (E, T); the one after it may be in the same memory."""
        steps = self.drive()
        if self.env.simulator.is_on_gpu:
            # What comes next counts the transitions: the times that are measured have it here.
            torch.cuda.current_stream(self.env.device).synchronize()
            # A replayed step does not look.
            self.env.simulator.gpu_roads.check(wait=False)
        return steps

    def drive(self) -> TensorDictBase:
        """The next batch, without waiting for it."""
        batch = self._drive(self._now)
        self._now = batch["last"]
        steps: TensorDictBase = batch["steps"]
        return steps

    @torch.no_grad()
    def _take_steps(self, now: TensorDictBase) -> TensorDict:
        steps = []
        with set_exploration_type(ExplorationType.RANDOM):
            for _ in range(self.num_steps):
                # The step adds to it, and the caller's stays as it is.
                step = self.env.step(self.policy(now.copy()))
                steps.append(step)
                now = self.env.step_mdp(step).exclude(*self.env.action_keys)
        return TensorDict({"steps": torch.stack(steps, 1), "last": now}, self.env.batch_size)

    def state(self) -> list[WorkerState]:
        """The roads."""
        return [{"roads": take_roads(self.env)}]

    def restore(self, states: Sequence[WorkerState]) -> None:
        """Put the roads back."""
        (state,) = check_states(states, 1)
        self.env.restore(state["roads"].numpy().tobytes())
        self._now = self.env.reset()

    def shutdown(self) -> None:
        """There is nothing to end."""
