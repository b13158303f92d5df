"""Roads that advance together, on processors or on a GPU: checks the inputs, makes the errors."""

import logging
import math
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from marl_lanes.scenario import Scenario, ScenarioError, load_scenario
from marl_lanes.scenario.dispositions import LEARNED
from marl_lanes.traffic.arguments import (
    check_flag,
    check_form,
    check_whole,
    choose_seed,
    is_on_gpu,
    read_mask,
    read_numbers,
)
from marl_lanes.traffic.machine.graphics import read_device
from marl_lanes.traffic.machine.state import Outcome, Records, State
from marl_lanes.traffic.machine.threads import count_processors, exclusive
from marl_lanes.traffic.parameters import make_parameters
from marl_lanes.traffic.placement import bytes_of_road, place_on_gpu, place_on_host
from marl_lanes.traffic.readout import Masks, read_masks
from marl_lanes.traffic.roles.changer import CHANGER
from marl_lanes.traffic.roles.external import FollowerPolicy, ask_policies, choose_policies
from marl_lanes.traffic.roles.follower import FOLLOWER
from marl_lanes.traffic.snapshot import read_snapshot, take_snapshot

if TYPE_CHECKING:
    from marl_lanes.traffic.gpu import GpuRoads

_LOG = logging.getLogger(__name__)

_ROADS_PER_THREAD = 1024
"""With fewer roads for each thread, another thread costs about as much time as it saves."""

# numpy compares with plain integers several times faster than with members of an enumeration.
_UNFINISHED = int(Outcome.UNFINISHED)

MAX_WAIT = 86_400.0
"""[s] Simulated time without a live agent after which an endless episode is an error."""

_NO_LEARNER = -2
"""A value that ``policy`` of FOLLOWER never has: it is -1 or more."""

_MOST_THREADS = 1024
_MOST_ROADS = _MOST_FIRST_ROAD = 2**63 - 1


class Simulator:
    """E independent roads of one scenario.

    The same seed and actions give the same bytes with any ``num_threads``. Road e of a batch is the
    same as road e of a simulator with more or fewer roads.

    With ``device="cuda"`` the roads are in the memory of a GPU and advance there: the same traffic.
    Then ``step``, ``reset`` and ``seed`` do not wait for it. Whatever reads a table (``agents``,
    ``state``, ``actions``, the masks, ``snapshot``) waits and fetches a copy, which is read-only.
    Policies of followers run on the host, with a copy there and back in each step. ``step`` also
    takes arrays of the GPU (with ``__cuda_array_interface__``). If an acting agent's action there
    is not finite, the roads stay as before that step, and the error comes from the first call that
    can see it: a later ``step``, or one that reads a table.

    Use it from one thread at a time. A call during another one, also of a follower's policy, raises
    RuntimeError. A process that is forked between calls has its own copy.

    Args:
        scenario: a shipped name, the path of a YAML file, a mapping or a Scenario.
        num_envs: E, >= 1.
        seed: of the random numbers, 0 to 2^64 - 1. None: drawn from the system's entropy;
            ``initial_seed`` tells it.
        num_threads: threads that share the roads, 1 to 1024; by default one for every 1024 roads,
            at most the number of processors that this process may use.
        overrides: scenario fields to replace, as in ``load_scenario``.
        learned_followers: ``step`` takes the actions of the followers whose disposition is
            ``learned``; if the mix has none, all followers are learned.
        follower_policies: policies by their name in ``followers.mix``; they have priority over
            registered ones.
        first_road: index of the first road for the random numbers: two simulators of 4 roads, with
            ``first_road`` 0 and 4, have the roads of one simulator of 8.
        device: where the roads are: ``cpu``, ``cuda`` or ``cuda:N``.

    Raises:
        ScenarioError: the scenario is invalid, or a follower of its mix has no policy.
        MissingExtraError: ``device`` needs the extra ``gpu``, which is not installed.
        ValueError: another argument has a wrong type, is out of range, or needs more memory than
            there is; or there is no such GPU.
    """

    def __init__(
        self,
        scenario: str | Path | Mapping[str, Any] | Scenario = "paper",
        num_envs: int = 1,
        *,
        seed: int | None = None,
        num_threads: int | None = None,
        overrides: Mapping[str, Any] | None = None,
        learned_followers: bool = False,
        follower_policies: Mapping[str, FollowerPolicy] | None = None,
        first_road: int = 0,
        device: object = "cpu",
    ) -> None:
        num_envs = check_whole("num_envs", num_envs, 1, _MOST_ROADS)
        if num_threads is not None:
            num_threads = check_whole("num_threads", num_threads, 1, _MOST_THREADS)
        first_road = check_whole("first_road", first_road, 0, _MOST_FIRST_ROAD)
        learned_followers = check_flag("learned_followers", learned_followers)
        gpu = read_device(device)
        seed = choose_seed(seed)
        self.scenario = load_scenario(scenario, overrides)
        if learned_followers and LEARNED not in self.scenario.followers.mix:
            self.scenario = load_scenario(self.scenario, {"followers": {"mix": {LEARNED: 1.0}}})
        self.learned_followers = learned_followers
        self.roles = (CHANGER, FOLLOWER) if learned_followers else (CHANGER,)
        names = self.scenario.followers.external_names
        self.learner = names.index(LEARNED) if learned_followers else _NO_LEARNER
        """``policy`` of the followers that ``follower_actions`` drive."""
        self._policies = choose_policies(
            self.scenario, follower_policies, has_learner=learned_followers
        )
        self.num_envs = num_envs
        self.first_road = first_road
        self.num_slots = self.scenario.num_slots
        self.num_actions = len(CHANGER.act(self.scenario))
        self.bytes_per_environment = bytes_of_road(self.scenario)
        """Memory of one road [bytes]: its part of the state and of the actions."""
        self.parameters = make_parameters(self.scenario)
        wanted = num_threads or min(count_processors(), num_envs // _ROADS_PER_THREAD)
        self.num_threads = max(1, min(wanted, num_envs))
        given = self.scenario, self.parameters, num_envs
        self._gpu_roads = (
            None if gpu is None else place_on_gpu(*given, learner=self.learner, gpu=gpu)
        )
        self._roads = self._gpu_roads or place_on_host(*given, self.num_threads)
        self.state = cast("State", self._roads.state)
        self.device = "cpu" if gpu is None else f"cuda:{gpu}"
        """Where the roads are."""
        self._lock = threading.Lock()
        self._is_fullness_told = False
        self.seed(seed)

    @property
    def actions(self) -> NDArray[np.float64]:
        """(E, A, D) of the last step, as given."""
        return self._roads.actions

    @property
    def follower_actions(self) -> NDArray[np.float64]:
        """(E, A, 1) of the last step, with those of policies."""
        return self._roads.follower_actions

    @property
    def is_on_gpu(self) -> bool:
        """Whether a GPU does all of a step: no policy of followers runs on the host."""
        return self._gpu_roads is not None and not any(self._policies)

    @property
    def gpu_roads(self) -> "GpuRoads":
        """The roads on a GPU, for what reads them there; a RuntimeError if they are not on one."""
        if self._gpu_roads is None:
            raise RuntimeError("gpu_roads: the roads are in this computer's memory: device = cpu")
        return self._gpu_roads

    @property
    def initial_seed(self) -> int:
        """The seed with which the present random numbers began, given or drawn."""
        return int(self.state.roads["random_key"][0])

    @exclusive
    def seed(self, seed: int | None = None) -> None:
        """Restart the random numbers; a road's stream is its index. Does not reset the roads.

        Args:
            seed: as for the constructor.
        """
        self._roads.seed(choose_seed(seed), self.first_road)

    @exclusive
    def reset(self, mask: ArrayLike | None = None) -> None:
        """Empty the masked roads (all by default) and run their warm-up.

        Args:
            mask: (E,) bool.

        Raises:
            ValueError: the mask has another shape or type.
        """
        if self._gpu_roads is not None and is_on_gpu(mask):
            check_form("mask", mask, (self.num_envs,), "?", self.device)
            chosen: Any = mask
        else:
            chosen = None if mask is None else read_mask("mask", mask, (self.num_envs,))
        self._tell_if_full(chosen)
        self._roads.begin(chosen)
        self._tell_if_full(chosen)

    def _tell_if_full(self, mask: Any) -> None:
        """Log, once, that departures waited because ``max_vehicles`` were on a masked road."""
        if self._is_fullness_told or not self._roads.is_full(mask):
            return
        self._is_fullness_told = True
        _LOG.warning(
            "scenario %r: max_vehicles = %d were on a road, so fewer vehicles enter than "
            "departures.interval says (num_held_back of the roads counts the steps of waiting)",
            self.scenario.name,
            self.scenario.max_vehicles,
        )

    @exclusive
    def step(
        self, actions: ArrayLike | None = None, follower_actions: ArrayLike | None = None
    ) -> None:
        """Advance every road by one time step.

        Args:
            actions: (E, A, D) yaw accelerations in the maneuver frame [rad/s^2] and, if D is 2,
                longitudinal accelerations [m/s^2], clipped to the scenario's bounds. The actions of
                agents that do not act have no effect. None: zeros.
            follower_actions: (E, A, 1) longitudinal accelerations [m/s^2] of the learned followers,
                clipped to the scenario's bounds, used where ``is_follower_acting``. None: zeros.

        Raises:
            ValueError: wrong type or shape, or the action of an acting agent is not finite.
            FollowerError: a follower's policy returned invalid accelerations.
        """
        # Nothing is kept of what is refused.
        given = self._read("actions", actions)
        given_followers = self._read("follower_actions", follower_actions)
        self._roads.put(given, given_followers)
        self._advance()

    @exclusive
    def advance(self) -> None:
        """``step`` with the contents of ``actions`` and ``follower_actions``, which must be finite.

        For callers that write to these arrays and check the values themselves.

        Raises:
            FollowerError: a follower's policy returned invalid accelerations.
        """
        self._advance()

    @exclusive
    def advance_until_live(self) -> None:
        """Advance each road without a live agent until it has one, or its episode is over.

        Raises:
            ScenarioError: the scenario has no horizon, and on some road no agent has become live in
                a day of simulated time, MAX_WAIT, or it has no commands at all.
        """
        num_steps = 0
        longest = math.ceil(MAX_WAIT / self.scenario.time_step)
        is_waiting = True
        while is_waiting:
            self.check_wait(num_steps)
            # An error does not depend on how many steps a call takes.
            steps = min(self._roads.steps_per_call, longest - num_steps % longest)
            self._roads.skip(steps)
            num_steps += steps
            roads = self.roads
            is_waiting = ((roads["num_live"] == 0) & (roads["is_done"] == 0)).any()

    def check_wait(self, num_steps: int) -> None:
        """Refuse to wait on for a live agent where one will hardly come.

        Args:
            num_steps: time steps without one so far.

        Raises:
            ScenarioError: the scenario has no horizon, and they last MAX_WAIT or longer, or it has
                no commands at all.
        """
        scenario = self.scenario
        if scenario.horizon is not None:
            return
        if scenario.command.probability == 0.0:
            raise ScenarioError(
                f"scenario {scenario.name!r}: command.probability = 0 and horizon = null: no agent "
                "would ever be live"
            )
        if num_steps * scenario.time_step >= MAX_WAIT:
            raise ScenarioError(
                f"scenario {scenario.name!r}: no agent has become live in "
                f"{num_steps * scenario.time_step:.0f} s of simulated time, and horizon = null: "
                "set a horizon, or let commands come sooner (departures.interval, "
                "command.probability, command.position, command.lanes)"
            )

    @exclusive
    def snapshot(self) -> bytes:
        """Every byte of the roads, with digests; ``restore`` continues from it."""
        return take_snapshot(self.state, self.parameters)

    @exclusive
    def restore(self, snapshot: bytes) -> None:
        """Continue from a snapshot of a simulator with the same scenario and number of roads.

        Raises:
            ValueError: the snapshot has another size, is of another scenario, is damaged, or holds
                roads that cannot be; nothing is changed.
        """
        stored = read_snapshot(snapshot, self._roads.tables, self.parameters)
        self._roads.put_state(stored)

    @property
    def has_longitudinal(self) -> bool:
        """Whether the changers' action has a second dimension."""
        return self.num_actions > 1

    @property
    def masks(self) -> Masks:
        """Which slots are live, steering and acting."""
        return read_masks(self.state.agents, has_longitudinal=self.has_longitudinal)

    @property
    def is_live(self) -> NDArray[np.bool_]:
        """(E, A): slots whose command is unfinished."""
        return self.masks.live

    @property
    def is_steering(self) -> NDArray[np.bool_]:
        """(E, A): slots whose agent steers, engaged or aborting."""
        return self.masks.steering

    @property
    def is_acting(self) -> NDArray[np.bool_]:
        """(E, A): slots whose action has an effect: steering, or live if D is 2."""
        return self.masks.acting

    @property
    def is_follower_acting(self) -> NDArray[np.bool_]:
        """(E, A): slots whose learned follower is paired now."""
        return np.asarray(self.state.followers["policy"] == self.learner)

    @property
    def has_ended(self) -> NDArray[np.bool_]:
        """(E, A): slots whose command ended in the last step."""
        return np.asarray(self.state.agents["outcome"] != _UNFINISHED)

    @property
    def vehicles(self) -> Records:
        """(E, V) the table VEHICLE; a slot with ``id`` -1 is empty."""
        return self.state.vehicles

    @property
    def agents(self) -> Records:
        """(E, A) the table AGENT."""
        return self.state.agents

    @property
    def roads(self) -> Records:
        """(E,) the table ROAD."""
        return self.state.roads

    def _read(self, name: str, given: Any) -> Any:
        """Actions. A value that is not finite becomes 0, or an error if its agent acts."""
        if given is None:
            return None
        is_changer = name == "actions"
        shape = (self.num_envs, self.num_slots, self.num_actions if is_changer else 1)
        if self._gpu_roads is not None and is_on_gpu(given):
            check_form(name, given, shape, "fd", self.device)
            return given
        array = read_numbers(name, given, shape)
        if np.isfinite(array).all():
            return array
        is_finite = np.isfinite(array)
        acting = self.is_acting if is_changer else self.is_follower_acting
        bad = acting[..., None] & ~is_finite
        if bad.any():
            env, slot, column = np.argwhere(bad)[0].tolist()
            raise ValueError(
                f"{name}[{env}, {slot}, {column}] = {array[env, slot, column]}: must be a finite "
                "acceleration"
            )
        return np.where(is_finite, array, 0.0)

    def _advance(self) -> None:
        if self._policies and any(self._policies):
            followers, seen = self.state.followers, self.state.follower_observations
            # Filled in once all have answered.
            answers = ask_policies(self._policies, followers["policy"], seen, self.scenario)
            self._roads.drive(answers)
        self._roads.step()

    def __getstate__(self) -> dict[str, Any]:
        # A copy has its own lock.
        own = ("_lock", "state")
        return {name: value for name, value in self.__dict__.items() if name not in own}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self.state = cast("State", self._roads.state)
        self._lock = threading.Lock()
