"""The TorchRL environment: E roads that advance together, their agents in reusable slots."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import Binary, Bounded, Composite, Unbounded
from torchrl.envs import EnvBase

from marl_lanes.scenario import Scenario
from marl_lanes.traffic.observation import feature_bounds
from marl_lanes.traffic.simulator import Simulator
from marl_lanes.traffic.state import Outcome

GROUP = "changers"
"""The group of the lane changers."""


class LaneChangeEnv(EnvBase):
    """Lane changes on E roads as a TorchRL environment with batch size [E].

    The group ``changers`` has the scenario's ``num_slots`` slots A, which commands take and leave:

    - ``observation`` (E, A, F) float32: the scenario's features; zeros in an absent slot, the last
      features in ``next`` of an agent that just ended.
    - ``action`` (E, A, 1) float32: yaw acceleration [rad/s^2] in the maneuver frame; used where
      ``engaged``, clipped to the bound.
    - ``mask`` (E, A) bool: live; at time t it says whose transition is valid.
    - ``engaged`` (E, A) bool: the agent steers, engaged or aborting.
    - ``reward`` (E, A, 1) float32, ``episode_reward`` (E, A, 1): its sum since the command.
    - ``outcome`` (E, A) int64: ``traffic.state.Outcome``; set in the step that ends a command.
    - ``done``, ``terminated``, ``truncated`` (E, A, 1) bool: pulses at an agent's end. Completed,
      collision and off-road terminate; missed and the horizon truncate.

    The root's ``done`` (E, 1) says that a road's episode is over: all of the scenario's
    ``num_agents`` commands are finished (terminated), or its horizon is reached (truncated). With
    ``num_agents: null`` and ``horizon: null`` it never is. The same scenario, seed and actions give
    on road 0 the trajectory of the PettingZoo environment.

    Args:
        scenario: a shipped name, the path of a YAML file, a mapping or a Scenario.
        num_envs: E, >= 1.
        device: where the tensors are; the traffic stays on the CPU.
        seed: of the random numbers.
        num_threads: as for ``Simulator``.
        overrides: scenario fields to replace, as in ``load_scenario``.

    Raises:
        ScenarioError: the scenario cannot be.
        ValueError: another argument is out of range.
    """

    def __init__(
        self,
        scenario: str | Path | Mapping[str, Any] | Scenario = "paper",
        num_envs: int = 1,
        *,
        device: torch.device | str | None = "cpu",
        seed: int = 0,
        num_threads: int | None = None,
        overrides: Mapping[str, Any] | None = None,
    ) -> None:
        self.simulator = Simulator(
            scenario, num_envs, seed=seed, num_threads=num_threads, overrides=overrides
        )
        super().__init__(device=device, batch_size=torch.Size([num_envs]))
        self.scenario = self.simulator.scenario
        self.group_map = {
            GROUP: [f"changer_{slot}" for slot in range(self.simulator.num_slots)],
        }
        self._is_restored = False
        self._make_specs()

    def restore(self, snapshot: bytes) -> None:
        """Go on from ``simulator.snapshot()`` of an equal environment.

        Resets return the restored state until the first step. A collector looks at its environment
        when it is built: call its ``reset`` after this.

        Raises:
            ValueError: the snapshot is of another size; nothing is changed.
        """
        self.simulator.restore(snapshot)
        self._is_restored = True

    def _make_specs(self) -> None:
        num_envs, num_slots = self.simulator.num_envs, self.simulator.num_slots
        low, high = (
            torch.from_numpy(bound) for bound in feature_bounds(self.scenario.observation.features)
        )
        group = (num_envs, num_slots)
        features = (*group, low.shape[0])
        flag = Binary(1, shape=(*group, 1), dtype=torch.bool)
        mask = Binary(num_slots, shape=group, dtype=torch.bool)
        self.observation_spec = self._group(
            observation=Bounded(
                low.expand(features), high.expand(features), features, dtype=torch.float32
            ),
            mask=mask,
            engaged=mask.clone(),
            episode_reward=Unbounded((*group, 1)),
            outcome=Bounded(0, max(Outcome), group, dtype=torch.int64),
        )
        bound = self.scenario.action.max_yaw_acceleration
        self.action_spec = self._group(
            action=Bounded(-bound, bound, (*group, 1), dtype=torch.float32)
        )
        self.reward_spec = self._group(reward=Unbounded((*group, 1)))
        done = Binary(1, shape=(num_envs, 1), dtype=torch.bool)
        self.done_spec = Composite(
            {
                GROUP: Composite(
                    done=flag, terminated=flag.clone(), truncated=flag.clone(), shape=group
                ),
                "done": done,
                "terminated": done.clone(),
                "truncated": done.clone(),
            },
            shape=(num_envs,),
        )
        if self.device is not None:
            self.to(self.device)

    def _group(self, **leaves: Any) -> Composite:
        shape = (self.simulator.num_envs, self.simulator.num_slots)
        return Composite({GROUP: Composite(leaves, shape=shape)}, shape=shape[:1])

    def _reset(self, tensordict: TensorDictBase | None = None, **_: Any) -> TensorDict:
        mask = None
        if tensordict is not None and "_reset" in tensordict.keys():  # noqa: SIM118
            mask = tensordict["_reset"].reshape(self.simulator.num_envs).cpu().numpy()
        if mask is not None or not self._is_restored:
            self.simulator.reset(mask)
        return self._make_tensordict(self._observe())

    def _step(self, tensordict: TensorDictBase) -> TensorDict:
        self._is_restored = False
        actions = tensordict[GROUP, "action"].detach().cpu().numpy()
        self.simulator.step(actions)
        group = self._observe()
        agents = self.simulator.agents
        outcome = agents["outcome"]
        has_ended = outcome != Outcome.UNFINISHED
        is_truncated = outcome >= Outcome.MISSED
        group["reward"] = agents["reward"].astype(np.float32)[..., None]
        group["done"] = has_ended[..., None]
        group["terminated"] = (has_ended & ~is_truncated)[..., None]
        group["truncated"] = is_truncated[..., None]
        roads = self.simulator.roads
        done = roads["is_done"].astype(np.bool_)
        is_cut = roads["is_cut"].astype(np.bool_)
        return self._make_tensordict(
            group,
            done=done[:, None],
            terminated=(done & ~is_cut)[:, None],
            truncated=is_cut[:, None],
        )

    def _observe(self) -> dict[str, NDArray[Any]]:
        agents = self.simulator.agents
        return {
            "observation": self.simulator.state.observations.copy(),
            "mask": self.simulator.is_live,
            "engaged": self.simulator.is_engaged,
            "episode_reward": agents["episode_reward"].astype(np.float32)[..., None],
            "outcome": agents["outcome"].astype(np.int64),
        }

    def _make_tensordict(
        self, group: Mapping[str, NDArray[Any]], **root: NDArray[np.bool_]
    ) -> TensorDict:
        shape = self.simulator.agents.shape
        leaves: dict[str, Tensor] = {
            key: torch.from_numpy(value).to(self.device) for key, value in group.items()
        }
        inner = TensorDict(leaves, batch_size=shape, device=self.device)
        outer: dict[str, Any] = {
            key: torch.from_numpy(value).to(self.device) for key, value in root.items()
        }
        return TensorDict({GROUP: inner, **outer}, batch_size=self.batch_size, device=self.device)

    def _set_seed(self, seed: int | None) -> None:
        self.simulator.seed(0 if seed is None else seed)
