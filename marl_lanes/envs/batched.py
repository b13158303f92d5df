"""The TorchRL environment: E roads that advance together, their agents in reusable slots."""

import time
from collections.abc import Callable, Mapping
from functools import wraps
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Binary, Bounded, Composite, Unbounded
from torchrl.envs import EnvBase

from marl_lanes.envs.followers import find_policies
from marl_lanes.scenario import Scenario, load_scenario
from marl_lanes.traffic.machine.state import Outcome
from marl_lanes.traffic.parameters import action_bounds, follower_action_bounds
from marl_lanes.traffic.readout import Readout, read_out
from marl_lanes.traffic.roles.external import FollowerPolicy
from marl_lanes.traffic.roles.observation import feature_bounds, follower_feature_bounds
from marl_lanes.traffic.simulator import Simulator

GROUP = "changers"
"""The group of the lane changers."""

FOLLOWERS = "followers"
"""The group of the learned followers."""

_ENDS = ("done", "terminated", "truncated")
_CPU = torch.device("cpu")


def _timed(method: Callable[..., TensorDict]) -> Callable[..., TensorDict]:
    """Add the wall time of each call to the environment's ``seconds``."""

    @wraps(method)
    def timed(self: Any, *args: Any, **kwargs: Any) -> TensorDict:
        start = time.perf_counter()
        result = method(self, *args, **kwargs)
        self.seconds += time.perf_counter() - start
        return result

    return timed


class LaneChangeEnv(EnvBase):
    """Lane changes on E roads as a TorchRL environment with batch size [E].

    The group ``changers`` has the scenario's ``num_slots`` slots A, which commands take and leave:

    - ``observation`` (E, A, F) float32: the scenario's features; zeros in an absent slot, the last
      features in ``next`` of an agent that just ended.
    - ``action`` (E, A, D) float32: yaw acceleration [rad/s^2] in the maneuver frame and, where the
      scenario has it, longitudinal acceleration [m/s^2]; used where ``acting``, clipped.
    - ``mask`` (E, A) bool: live; at time t it says whose transition is valid.
    - ``engaged`` (E, A) bool: the agent steers, engaged or aborting.
    - ``aborting`` (E, A) bool: of these, who steers back to the lane that it came from.
    - ``acting`` (E, A) bool: its action has an effect: where ``engaged``, or live where D is 2.
    - ``reward`` (E, A, 1) float32, ``episode_reward`` (E, A, 1): its sum since the command.
    - ``outcome`` (E, A) int64: ``traffic.state.Outcome``; set in the step that ends a command.
    - ``done``, ``terminated``, ``truncated`` (E, A, 1) bool: pulses at an agent's end. Completed,
      collision and off-road terminate; missed and the horizon truncate.

    With ``learned_followers`` there is the group ``followers``: slot k is the driver behind the
    changer of slot k in its target lane, live (``mask``) as long as the changer, ``acting`` while
    it is paired: the changer is engaged. Its ``observation`` (E, A, G) has the columns
    FOLLOWER_FEATURES, its ``action`` (E, A, 1) is the longitudinal acceleration [m/s^2]; the other
    keys are as above, its end is the command's.

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
        learned_followers: add the group ``followers``, of the drivers whose disposition is
            ``learned``, or of all where the mix has none of these.
        follower_policies: policies by their name in ``followers.mix``, before registered ones.
        first_road: index of the first road among the seed's, as for ``Simulator``.

    Attributes:
        seconds: wall time so far in its own steps and resets, without TorchRL's work around them.

    Raises:
        ScenarioError: the scenario cannot be, or a follower of its mix has no policy.
        CheckpointError: the checkpoint of the learned follower cannot be used.
        ValueError: another argument is out of range.
    """

    seconds = 0.0

    def __init__(
        self,
        scenario: str | Path | Mapping[str, Any] | Scenario = "paper",
        num_envs: int = 1,
        *,
        device: torch.device | str | None = "cpu",
        seed: int = 0,
        num_threads: int | None = None,
        overrides: Mapping[str, Any] | None = None,
        learned_followers: bool = False,
        follower_policies: Mapping[str, FollowerPolicy] | None = None,
        first_road: int = 0,
    ) -> None:
        loaded = load_scenario(scenario, overrides)
        self.simulator = Simulator(
            loaded,
            num_envs,
            seed=seed,
            num_threads=num_threads,
            learned_followers=learned_followers,
            follower_policies=find_policies(
                loaded, follower_policies, has_learner=learned_followers
            ),
            first_road=first_road,
        )
        super().__init__(device=device, batch_size=torch.Size([num_envs]))
        self.scenario = self.simulator.scenario
        self.group_map = {
            GROUP: [f"changer_{slot}" for slot in range(self.simulator.num_slots)],
        }
        if learned_followers:
            self.group_map[FOLLOWERS] = [
                f"follower_{slot}" for slot in range(self.simulator.num_slots)
            ]
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
        group = (num_envs, num_slots)
        flag = Binary(1, shape=(*group, 1), dtype=torch.bool)
        mask = Binary(num_slots, shape=group, dtype=torch.bool)
        total = Unbounded((*group, 1))
        low, high = action_bounds(self.scenario)
        seen = {
            GROUP: {
                "observation": self._bounded(*feature_bounds(self.scenario.observation.features)),
                "mask": mask,
                "engaged": mask.clone(),
                "aborting": mask.clone(),
                "acting": mask.clone(),
                "episode_reward": total,
                "outcome": Bounded(0, max(Outcome), group, dtype=torch.int64),
            }
        }
        actions = {GROUP: {"action": self._bounded(low, high)}}
        if FOLLOWERS in self.group_map:
            seen[FOLLOWERS] = {
                "observation": self._bounded(*follower_feature_bounds()),
                "mask": mask.clone(),
                "acting": mask.clone(),
                "episode_reward": total.clone(),
            }
            actions[FOLLOWERS] = {"action": self._bounded(*follower_action_bounds(self.scenario))}
        self.observation_spec = self._grouped(seen)
        self.action_spec = self._grouped(actions)
        self.reward_spec = self._grouped(
            {name: {"reward": Unbounded((*group, 1))} for name in self.group_map}
        )
        done = Binary(1, shape=(num_envs, 1), dtype=torch.bool)
        self.done_spec = Composite(
            {
                **{
                    name: Composite({key: flag.clone() for key in _ENDS}, shape=group)
                    for name in self.group_map
                },
                **{key: done.clone() for key in _ENDS},
            },
            shape=(num_envs,),
        )
        if self.device is not None:
            self.to(self.device)

    def _bounded(self, low: NDArray[np.float32], high: NDArray[np.float32]) -> Bounded:
        """The spec of (E, A, n) between two vectors (n,)."""
        shape = (self.simulator.num_envs, self.simulator.num_slots, len(low))
        bounds = (torch.from_numpy(bound).expand(shape) for bound in (low, high))
        return Bounded(*bounds, shape, dtype=torch.float32)

    def _grouped(self, groups: Mapping[str, Mapping[str, Any]]) -> Composite:
        shape = (self.simulator.num_envs, self.simulator.num_slots)
        inner = {name: Composite(dict(leaves), shape=shape) for name, leaves in groups.items()}
        return Composite(inner, shape=shape[:1])

    @_timed
    def _reset(self, tensordict: TensorDictBase | None = None, **_: Any) -> TensorDict:
        mask = None
        if tensordict is not None and "_reset" in tensordict.keys():  # noqa: SIM118
            mask = tensordict["_reset"].reshape(self.simulator.num_envs).cpu().numpy()
        if mask is not None or not self._is_restored:
            self.simulator.reset(mask)
        return self._make_tensordict(self._observe(self._read_out()))

    @_timed
    def _step(self, tensordict: TensorDictBase) -> TensorDict:
        if self._is_restored:
            self._is_restored = False
        actions = [
            tensordict[group, "action"].detach().cpu().numpy()
            for group in (GROUP, FOLLOWERS)
            if group in self.group_map
        ]
        simulator = self.simulator
        simulator.step(*actions)
        columns = self._read_out()
        groups = self._observe(columns)
        ends = {name: getattr(columns, name) for name in _ENDS}
        groups[GROUP] |= {"reward": columns.reward, **ends}
        if FOLLOWERS in groups:
            reward = simulator.state.followers["reward"].astype(np.float32)[..., None]
            # The groups share no memory, as users may write to one.
            copies = {name: flags.copy() for name, flags in ends.items()}
            groups[FOLLOWERS] |= {"reward": reward, **copies}
        done = simulator.roads["is_done"].astype(np.bool_)
        is_cut = simulator.roads["is_cut"].astype(np.bool_)
        return self._make_tensordict(
            groups,
            done=done[:, None],
            terminated=(done & ~is_cut)[:, None],
            truncated=is_cut[:, None],
        )

    def _step_proc_data(self, next_tensordict_out: TensorDictBase) -> TensorDictBase:
        """What ``_step`` returned: every key of the specs is there, with its shape and dtype.

        TorchRL's own looks for missing ones at every step.
        """
        if self.run_type_checks:
            return super()._step_proc_data(next_tensordict_out)
        return next_tensordict_out

    def _read_out(self) -> Readout:
        return read_out(self.simulator.agents, acts_waiting=self.simulator.num_actions > 1)

    def _observe(self, columns: Readout) -> dict[str, dict[str, NDArray[Any]]]:
        simulator = self.simulator
        groups: dict[str, dict[str, NDArray[Any]]] = {
            GROUP: {
                "observation": simulator.state.observations.copy(),
                "mask": columns.mask,
                "engaged": columns.engaged,
                "aborting": columns.aborting,
                "acting": columns.acting,
                "episode_reward": columns.episode_reward,
                "outcome": columns.outcome,
            }
        }
        if FOLLOWERS in self.group_map:
            total = simulator.state.followers["episode_reward"].astype(np.float32)
            groups[FOLLOWERS] = {
                "observation": simulator.state.follower_observations.copy(),
                "mask": columns.mask.copy(),
                "acting": simulator.is_follower_acting,
                "episode_reward": total[..., None],
            }
        return groups

    def _make_tensordict(
        self, groups: Mapping[str, Mapping[str, NDArray[Any]]], **root: NDArray[np.bool_]
    ) -> TensorDict:
        # The shapes are known to fit: checking each takes longer than making it.
        shape = torch.Size(self.simulator.agents.shape)
        device = self.device
        is_elsewhere = device is not None and device.type != "cpu"
        near = _CPU if is_elsewhere else device
        made: dict[str, Any] = {
            name: TensorDict._new_unsafe(
                {key: torch.from_numpy(value) for key, value in group.items()}, shape, near
            )
            for name, group in groups.items()
        }
        for key, value in root.items():
            made[key] = torch.from_numpy(value)
        tensordict = TensorDict._new_unsafe(made, self.batch_size, near)
        return tensordict.to(device) if is_elsewhere else tensordict

    def _set_seed(self, seed: int | None) -> None:
        self.simulator.seed(0 if seed is None else seed)
