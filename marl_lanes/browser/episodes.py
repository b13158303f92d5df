"""One simulation for all viewers: episode after episode, at the pace of the clock."""

import asyncio
import secrets
from collections.abc import Mapping
from typing import Any

import numpy as np

from marl_lanes.browser.encoding import encode_chunk, encode_header
from marl_lanes.browser.hub import Hub
from marl_lanes.browser.models import Model, Models
from marl_lanes.envs.followers import find_policies
from marl_lanes.evaluation.driving import drive
from marl_lanes.scenario import Scenario
from marl_lanes.traffic.machine.state import NONE
from marl_lanes.traffic.roles.changer import CHANGER
from marl_lanes.traffic.roles.external import FollowerPolicy
from marl_lanes.traffic.simulator import Simulator
from marl_lanes.trajectory.columns import new_rows
from marl_lanes.trajectory.events import Event, find_events
from marl_lanes.trajectory.frames import FrameReader, Rows
from marl_lanes.trajectory.metadata import Metadata

MAX_EPISODE = 600.0
"""[s] An episode ends here at the latest: so newer models have their turn, and a browser's memory
is bounded."""

MIN_SPEED, MAX_SPEED = 0.1, 20.0
"""Of the simulation, relative to real time: those that the page can play."""

_SECONDS_AFTER = 5.0
"""[s] That are shown after the last command has ended."""

_PERIOD = 0.5
"""[s] About so often viewers get new steps."""

_POLLING = 1.0
"""[s] Between two looks for the first model."""

_NUM_SEEDS = 2**64


class Episode:
    """One road of traffic, driven step by step and read as chunks for the page.

    Args:
        scenario: of the road.
        model: drives the lane changers.
        seed: of the traffic.
        follower_policies: those that the simulator does not find itself.
    """

    def __init__(
        self,
        scenario: Scenario,
        model: Model,
        seed: int,
        follower_policies: Mapping[str, FollowerPolicy],
    ) -> None:
        self.header = encode_header(Metadata(scenario, seed, model.label), 0)
        self._time_step = scenario.time_step
        self._simulator = Simulator(scenario, seed=seed, follower_policies=follower_policies)
        self._simulator.reset()
        self._reader = FrameReader(self._simulator)
        self._driving = drive(self._simulator, model.policy)
        self._last = new_rows(0)
        self._commands: dict[int, int] = {}
        self._ended_step: int | None = None

    @property
    def time(self) -> float:
        """Since the warm-up ended [s]."""
        return self._step * self._time_step

    @property
    def is_over(self) -> bool:
        """Whether the last command ended some seconds ago, or the episode is too long."""
        if self.time >= MAX_EPISODE:
            return True
        if self._ended_step is None:
            return False
        return (self._step - self._ended_step) * self._time_step >= _SECONDS_AFTER

    def read(self) -> dict[str, Any] | None:
        """The chunk of the road as it is; None without vehicles."""
        return self._encode(self._reader.read())

    def drive(self, num_steps: int) -> dict[str, Any] | None:
        """Drive some steps, fewer if the episode is over before.

        Returns:
            their chunk; None without vehicles.
        """
        blocks = [new_rows(0)]
        while len(blocks) <= num_steps and not self.is_over:
            self._advance()
            blocks.append(self._reader.read())
        return self._encode(np.concatenate(blocks))

    @property
    def _step(self) -> int:
        return int(self._simulator.roads["step"][0])

    def _advance(self) -> None:
        next(self._driving)
        if self._ended_step is None and self._simulator.roads["is_done"][0]:
            self._ended_step = self._step

    def _encode(self, rows: Rows) -> dict[str, Any] | None:
        if not rows.size:
            return None
        events = self._find_events(rows)
        self._last = rows[rows["step"] == rows["step"].max()]
        return encode_chunk(rows, events)

    def _find_events(self, rows: Rows) -> list[Event]:
        """The events of new rows: what is new beside the frame before them."""
        first = rows["step"].min()
        events = [
            event
            for event in find_events(np.concatenate([self._last, rows]))
            if event.step >= first
        ]
        # A command that ended before that frame is known only here.
        events = [
            event._replace(command=self._commands.get(event.vehicle))
            if event.command is None
            else event
            for event in events
        ]
        commanded = rows[rows["command"] != NONE]
        self._commands |= dict(
            zip(commanded["vehicle"].tolist(), commanded["command"].tolist(), strict=True)
        )
        return events


class Show:
    """What is driven for the viewers.

    Args:
        scenario: of the road.
        models: asked before each episode who drives it.
        seed: of the first episode. The k-th one after it has the seed + k, so that each can be
            recorded again.
        speed: relative to real time, MIN_SPEED to MAX_SPEED.

    Raises:
        ValueError: the seed or the speed is out of range.
        CheckpointError: the checkpoint of the learned followers cannot be read or does not fit.
    """

    def __init__(
        self, scenario: Scenario, models: Models, *, seed: int = 0, speed: float = 1.0
    ) -> None:
        if not 0 <= seed < _NUM_SEEDS:
            raise ValueError(f"seed = {seed}: must be 0 to 2^64 - 1")
        if not MIN_SPEED <= speed <= MAX_SPEED:
            raise ValueError(f"speed = {speed}: must be {MIN_SPEED:g} to {MAX_SPEED:g}")
        self.scenario = scenario
        self.models = models
        self.seed = seed
        self.speed = speed
        self._follower_policies = find_policies(scenario)

    def prepare(self) -> None:
        """Compile what the first episode needs, before anyone waits for it.

        Raises:
            ScenarioError: a follower of the mix has no policy.
        """
        num_actions = len(CHANGER.act(self.scenario))
        zeros = Model("zeros", lambda seen: np.zeros((len(seen), num_actions)))
        episode = self._begin(zeros, 0)
        episode.read()
        episode.drive(1)

    async def run(self, hub: Hub) -> None:
        """Drive episodes as long as the task lives; while nobody watches, nothing is done.

        Raises:
            FollowerError: the policy of a follower has failed.
        """
        # A browser that comes back sees by the name whether it has rows of the same episode.
        stream, number = secrets.token_hex(8), 0
        while True:
            await hub.wait_for_viewer()
            model = await asyncio.to_thread(self.models.find_newest)
            waiting = self.models.waiting if model is None else None
            hub.say({"waiting": waiting, "trouble": self.models.trouble})
            if model is None:
                await asyncio.sleep(_POLLING)
                continue
            episode = await asyncio.to_thread(self._begin, model, number)
            name = f"{stream}-{number}"
            hub.begin({"name": name, "speed": self.speed, "header": episode.header})
            await self._drive(hub, episode)
            number += 1

    def _begin(self, model: Model, number: int) -> Episode:
        seed = (self.seed + number) % _NUM_SEEDS
        return Episode(self.scenario, model, seed, self._follower_policies)

    async def _drive(self, hub: Hub, episode: Episode) -> None:
        """One episode, at the pace of the clock, or of the computer if that is slower."""
        clock = asyncio.get_running_loop().time
        seconds_per_step = self.scenario.time_step / self.speed
        num_steps = max(1, round(_PERIOD / seconds_per_step))
        chunk = await asyncio.to_thread(episode.read)
        due = clock()
        while True:
            if chunk is not None:
                hub.append(episode.time, chunk)
            if episode.is_over:
                return
            due = max(due + num_steps * seconds_per_step, clock())
            await asyncio.sleep(due - clock())
            if await hub.wait_for_viewer():
                due = clock()
            chunk = await asyncio.to_thread(episode.drive, num_steps)
