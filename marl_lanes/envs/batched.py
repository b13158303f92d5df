"""The TorchRL environment: E roads that advance together, their agents in reusable slots."""

import os
import sys
from collections.abc import Mapping
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict, TensorDictBase
from torchrl.envs import EnvBase

from marl_lanes.envs.closing import Closes
from marl_lanes.envs.followers import find_policies
from marl_lanes.envs.gpu_exchange import Exchange, check_device
from marl_lanes.envs.sizes import bytes_of_batched_road
from marl_lanes.envs.specs import ENDS, make_specs
from marl_lanes.envs.tensordict_internals import make_tensordict
from marl_lanes.envs.timing import timed
from marl_lanes.envs.vehicle_table import read_vehicle_tables
from marl_lanes.memory import check_memory
from marl_lanes.scenario import Scenario, load_scenario
from marl_lanes.scenario.messages import shown
from marl_lanes.traffic.arguments import check_flag, check_whole
from marl_lanes.traffic.readout import Columns, read_changers, read_followers
from marl_lanes.traffic.roles.changer import CHANGER
from marl_lanes.traffic.roles.external import FollowerPolicy
from marl_lanes.traffic.simulator import Simulator

if TYPE_CHECKING:
    from marl_lanes.envs.rendering import Renderer, View

_CPU = torch.device("cpu")


class LaneChangeEnv(Closes, EnvBase):
    """Lane changes on E roads as a TorchRL environment with batch size [E].

    The group ``changers`` has A = ``num_slots`` slots; a command occupies a slot until it ends:

    - ``observation`` (E, A, F) float32: the columns of ``CHANGER.seen(scenario)``; zeros in an
      absent slot; the last observation in ``next`` of an agent that has just ended.
    - ``action`` (E, A, D) float32: yaw acceleration [rad/s^2] in the maneuver frame and, if the
      scenario has a second action, longitudinal acceleration [m/s^2]; used where ``acting``,
      clipped.
    - ``mask`` (E, A) bool: the agent is live; at time t, its transition is valid.
    - ``steering`` (E, A) bool: the agent steers, engaged or aborting.
    - ``aborting`` (E, A) bool: the agent steers back to its origin lane.
    - ``acting`` (E, A) bool: the action has an effect: ``steering`` if D is 1, ``mask`` if D is 2.
    - ``reward`` (E, A, 1) float32; ``command_reward`` (E, A, 1): its sum since the command.
    - ``outcome`` (E, A) int64: an ``Outcome``; set in the step that ends a command.
    - ``done``, ``terminated``, ``truncated`` (E, A, 1) bool: True only in the step in which the
      agent ends. Completed, collision and off_road terminate, all other outcomes truncate.

    With ``learned_followers`` there is the group ``followers``: slot k is the driver behind the
    changer of slot k in its target lane. It is live (``mask``) as long as the changer, and
    ``acting`` while it is paired and the changer engaged. Its ``observation`` (E, A, G) has the
    columns FOLLOWER_COLUMNS, its ``action`` (E, A, 1) is the longitudinal acceleration [m/s^2].
    The other keys are as above; it ends with the command.

    With ``has_state`` the root has a ``state`` (E, max_vehicles, columns) float32: every vehicle of
    the road by decreasing position, with ``state_columns``; ``agent`` is the slot of the vehicle's
    agent, or -1. Rows without a vehicle are zero, with agent -1.

    The root's ``done`` (E, 1) is the end of a road's episode: all ``num_agents`` commands of the
    scenario are finished (terminated), or the horizon is reached (truncated). With
    ``num_agents: null`` and ``horizon: null`` an episode never ends. With the same scenario, seed
    and actions, road 0 has the same trajectory as the PettingZoo environment, whose ``reset`` skips
    the episodes that end before the first command; here they are driven, with an empty ``mask``.

    With ``device="cuda"`` a step does not wait for the GPU, and its tensors are new ones. Its
    kernels are on torch's present stream, also while a CUDA graph is captured. A non-finite action
    of an acting agent stops the roads before that step; the error comes from a later step, or from
    the first call that waits, such as ``simulator.snapshot``. ``seconds`` leaves out what the GPU
    does meanwhile. Policies of followers, ``render`` and a reset with a mask in the computer's
    memory copy and wait.

    Use it from one thread at a time. ``make`` functions without a seed make environments that
    differ, also in workers. A copy (pickle, deepcopy) goes on with the same random numbers; one of
    an environment without a seed that has not been reset draws its own.

    Args:
        scenario: a shipped name, the path of a YAML file, a mapping or a Scenario.
        num_envs: E, >= 1.
        device: where the traffic and the tensors are: ``cpu``, or ``cuda[:N]`` for a GPU. With
            another device, and after ``to``, only the tensors are there.
        seed: of the random numbers, 0 to 2^64 - 1. None: drawn from the system's entropy, as by
            ``set_seed(None)``.
        num_threads: as for ``Simulator``.
        overrides: scenario fields to replace, as in ``load_scenario``.
        learned_followers: add the group ``followers`` for the drivers with the disposition
            ``learned``, or for all drivers if the mix has no ``learned``.
        follower_policies: policies by their name in ``followers.mix``; they have priority over
            registered ones.
        first_road: index of the first road within the seed's roads, as for ``Simulator``.
        has_state: add ``state``, for a centralised critic.
        render_mode: None, or "rgb_array": ``render`` returns a picture of a road.
        view: how a road is shown, ``ViewOptions`` or a mapping of its fields; not used where
            render_mode is None.

    Attributes:
        seconds: wall time of its steps and resets so far, without TorchRL's work around them.
        has_state: whether there is ``state``.
        initial_seed: the seed with which the present random numbers began, given or drawn.

    Raises:
        ScenarioError: the scenario is invalid, or a follower of its mix has no policy.
        CheckpointError: the checkpoint of the learned follower cannot be used.
        MissingExtraError: render_mode needs the extra ``view``, or device the extra ``gpu``, which
            is not installed.
        ValueError: another argument has a wrong type, is out of range, or needs more memory than
            there is.
    """

    seconds = 0.0

    def __init__(
        self,
        scenario: str | Path | Mapping[str, Any] | Scenario = "paper",
        num_envs: int = 1,
        *,
        device: torch.device | str | None = "cpu",
        seed: int | None = None,
        num_threads: int | None = None,
        overrides: Mapping[str, Any] | None = None,
        learned_followers: bool = False,
        follower_policies: Mapping[str, FollowerPolicy] | None = None,
        first_road: int = 0,
        has_state: bool = False,
        render_mode: str | None = None,
        view: "View" = None,
    ) -> None:
        if render_mode not in (None, "rgb_array"):
            raise ValueError(f"render_mode = {shown(render_mode)}: must be None or 'rgb_array'")
        chosen_device = None if device is None else check_device(device)
        is_there = chosen_device is not None and chosen_device.type == "cuda"
        loaded = load_scenario(scenario, overrides)
        learned_followers = check_flag("learned_followers", learned_followers)
        num_envs = check_whole("num_envs", num_envs, 1, sys.maxsize)
        self.has_state = check_flag("has_state", has_state)
        if not is_there:
            size = bytes_of_batched_road(
                loaded, has_followers=learned_followers, has_state=self.has_state
            )
            check_memory("num_envs", num_envs, num_envs * size)
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
            device=chosen_device if is_there else "cpu",
        )
        super().__init__(device=chosen_device, batch_size=torch.Size([num_envs]))
        self.scenario = self.simulator.scenario
        self.roles = self.simulator.roles
        self._exchange = (
            Exchange(self.simulator, chosen_device, self.roles, self.has_state)
            if chosen_device is not None and is_there
            else None
        )
        self.group_map = {
            role.group: [f"{role.name}_{slot}" for slot in range(self.simulator.num_slots)]
            for role in self.roles
        }
        self._is_restored = False
        # Whether the seed is not given, and no traffic is of it yet; and in which process.
        self._is_drawn, self._process = seed is None, os.getpid()
        self.render_mode = render_mode
        self._view = view
        self._renderers: dict[int, Renderer] = {}
        if render_mode is not None:
            self._find_renderer(0)
        self._set_specs()

    @property
    def initial_seed(self) -> int:
        """The seed with which the present random numbers began, given or drawn."""
        return self.simulator.initial_seed

    def __setstate__(self, state: dict[str, Any]) -> None:
        super().__setstate__(state)
        if self._is_drawn:
            # Collectors and vector environments copy one that has not been used.
            self._set_seed(None)
            self._process = os.getpid()

    def restore(self, snapshot: bytes) -> None:
        """Continue from ``simulator.snapshot()`` of an equal environment.

        Until the first step, a reset returns the restored state. A collector reads its environment
        when it is built: call its ``reset`` after this.

        Raises:
            ValueError: as for ``Simulator.restore``; nothing is changed.
        """
        self.simulator.restore(snapshot)
        self._is_restored, self._is_drawn = True, False
        for renderer in self._renderers.values():
            renderer.restart()

    def render(self, road: int = 0) -> NDArray[np.uint8]:
        """A road as it is now.

        The first picture of a road other than 0 lacks what only the step before it knew: the
        vehicles that the step removed, and the actions.

        Args:
            road: index of the road within the environment, 0 to E - 1.

        Returns:
            (H, W, 3) uint8, the same bytes until the next step.

        Raises:
            ValueError: there is no such road, or the environment has no render_mode.
        """
        if self.render_mode is None:
            raise ValueError(
                "render: render_mode = None: make the environment with render_mode='rgb_array'"
            )
        return self._find_renderer(road).render()

    def _find_renderer(self, road: int) -> "Renderer":
        if road not in self._renderers:
            # Imported here, because an environment that shows nothing needs none of it.
            from marl_lanes.envs.rendering import Renderer

            self._renderers[road] = Renderer(self.simulator, road, self._view)
        return self._renderers[road]

    def _set_specs(self) -> None:
        specs = make_specs(
            self.scenario, self.roles, self.simulator.num_envs, has_state=self.has_state
        )
        self.observation_spec = specs.observation
        self.action_spec = specs.action
        self.reward_spec = specs.reward
        self.done_spec = specs.done
        if self.device is not None:
            self.to(self.device)

    @timed
    def _reset(self, tensordict: TensorDictBase | None = None, **_: Any) -> TensorDict:
        mask = None
        if tensordict is not None and "_reset" in tensordict.keys():  # noqa: SIM118
            mask = tensordict["_reset"].reshape(self.simulator.num_envs)
            if self._exchange is None or mask.device != self._exchange.device:
                mask = mask.cpu().numpy()
        if self._is_drawn and os.getpid() != self._process:
            # They may fork, too.
            self._set_seed(None)
        self._is_drawn = False
        with self._streamed():
            if mask is not None or not self._is_restored:
                self.simulator.reset(mask)
                for road, renderer in self._renderers.items():
                    if mask is None or mask[road]:
                        renderer.restart()
            if self._exchange is not None:
                return self._exchange.read(self.device, is_start=True)
        groups = self._read_out()
        for columns in groups.values():
            for key in ("reward", *ENDS):
                del columns[key]
        return self._make_tensordict(groups, **self._read_state())

    def _step_there(self, exchange: Exchange, tensordict: TensorDictBase) -> TensorDict:
        """The step of roads on a GPU, which nothing waits for."""
        with exchange.stream():
            exchange.put(tensordict)
            for renderer in self._renderers.values():
                renderer.note()
            self.simulator.advance()
            self._is_restored = False
            return exchange.read(self.device)

    def _streamed(self) -> AbstractContextManager[None]:
        """Work on a GPU is on torch's present stream there."""
        return nullcontext() if self._exchange is None else self._exchange.stream()

    @timed
    def _step(self, tensordict: TensorDictBase) -> TensorDict:
        if self._exchange is not None:
            return self._step_there(self._exchange, tensordict)
        simulator = self.simulator
        actions = [_read_actions(tensordict, role.group) for role in self.roles]
        for renderer in self._renderers.values():
            renderer.note()
        simulator.step(*actions)
        if self._is_restored:
            self._is_restored = False
        groups = self._read_out()
        done = simulator.roads["is_done"].astype(np.bool_)
        is_cut = simulator.roads["is_cut"].astype(np.bool_)
        return self._make_tensordict(
            groups,
            **self._read_state(),
            done=done[:, None],
            terminated=(done & ~is_cut)[:, None],
            truncated=is_cut[:, None],
        )

    def _step_proc_data(self, next_tensordict_out: TensorDictBase) -> TensorDictBase:
        """The result of ``_step``, which has every key of the specs with its shape and dtype.

        TorchRL's method checks for missing keys at every step.
        """
        if self.run_type_checks:
            return super()._step_proc_data(next_tensordict_out)
        return next_tensordict_out

    def _read_out(self) -> dict[str, Columns]:
        """Observations, masks, rewards and ends of the agents, by group."""
        simulator, state = self.simulator, self.simulator.state
        groups = {}
        for role in self.roles:
            columns = (
                read_changers(state.agents, has_longitudinal=simulator.has_longitudinal)
                if role is CHANGER
                else read_followers(state.agents, state.followers, policy=simulator.learner)
            )
            columns["observation"] = getattr(state, role.observations).copy()
            groups[role.group] = columns
        return groups

    def _read_state(self) -> dict[str, NDArray[np.float32]]:
        return {"state": read_vehicle_tables(self.simulator)} if self.has_state else {}

    def _make_tensordict(
        self, groups: Mapping[str, Mapping[str, NDArray[Any]]], **root: NDArray[Any]
    ) -> TensorDict:
        shape = torch.Size((self.simulator.num_envs, self.simulator.num_slots))
        device = self.device
        is_elsewhere = device is not None and device.type != "cpu"
        near = _CPU if is_elsewhere else device
        made: dict[str, Any] = {
            name: make_tensordict(
                {key: torch.from_numpy(value) for key, value in group.items()}, shape, near
            )
            for name, group in groups.items()
        }
        made |= {key: torch.from_numpy(value) for key, value in root.items()}
        tensordict = make_tensordict(made, self.batch_size, near)
        return tensordict.to(device) if is_elsewhere else tensordict

    def _set_seed(self, seed: int | None) -> None:
        self._is_drawn = seed is None
        with self._streamed():
            self.simulator.seed(seed)


def _read_actions(tensordict: TensorDictBase, group: str) -> NDArray[Any]:
    """The group's actions, in the memory of this computer."""
    action = tensordict.get((group, "action"), None)
    if not isinstance(action, torch.Tensor):
        raise ValueError(f"action of the group {group!r}: must be given")
    if action.dtype is torch.bfloat16:
        action = action.float()
    return action.detach().cpu().numpy()
