"""The dicts of a step of the PettingZoo environment, read off its road."""

from collections.abc import Mapping, Sequence
from typing import Any

from marl_lanes.envs.infos import FIELDS, Step, info_names
from marl_lanes.traffic.machine.state import Outcome, Phase, truncates
from marl_lanes.traffic.roles.changer import CHANGER
from marl_lanes.traffic.roles.follower import FOLLOWER
from marl_lanes.traffic.simulator import Simulator

_TRUNCATING = {int(outcome) for outcome in Outcome if truncates(outcome)}

_ABSENT = int(Phase.ABSENT)
_UNFINISHED = int(Outcome.UNFINISHED)


class StepReader:
    """Reads who is live on a road, or has just ended, and what is told of them.

    Args:
        simulator: of one road.
        names: of the agents of each role, by the role's name and then by command.

    Attributes:
        slots: of the agents that were live when the road was read last.
        is_done: (1,) whether the road's episode is over.
    """

    def __init__(self, simulator: Simulator, names: Mapping[str, Sequence[str]]) -> None:
        self.slots: dict[str, int] = {}
        self._simulator, self._names = simulator, names
        together = [name for role in names.values() for name in role]
        self._rank = {name: rank for rank, name in enumerate(together)}
        self._view()

    def _view(self) -> None:
        """Keep views of the road's arrays: making them at every step would be slow."""
        state = self._simulator.state
        table = state.agents[0]
        self._seen, self.is_done = state.observations[0], state.roads["is_done"]
        self._phases, self._outcomes = table["phase"], table["outcome"]
        self._commands, self._rewards = table["command"], table["reward"]
        self._told = [table[name] for name in FIELDS]
        self._told += [table["terms"][:, index] for index in range(len(CHANGER.terms))]

    def __setstate__(self, state: dict[str, Any]) -> None:
        # The views of a copy must belong to its own road.
        self.__dict__.update(state)
        self._view()

    def read(self, result: Step) -> list[str]:
        """Write the values of the live agents and of those that have just ended to the dicts.

        Args:
            result: what is not there yet is added, what is there is replaced.

        Returns:
            The live agents, in the order of their names.
        """
        observations, rewards, terminations, truncations, infos = result
        agents: list[str] = []
        self.slots.clear()
        phases, outcomes = self._phases.tolist(), self._outcomes.tolist()
        for slot, (phase, outcome) in enumerate(zip(phases, outcomes, strict=True)):
            is_over = outcome != _UNFINISHED
            if phase == _ABSENT and not is_over:
                continue
            command = self._commands.item(slot)
            name = self._names[CHANGER.name][command]
            truncations[name] = outcome in _TRUNCATING
            terminations[name] = is_over and outcome not in _TRUNCATING
            observations[name] = self._seen[slot].copy()
            rewards[name] = self._rewards.item(slot)
            values = [float(column.item(slot)) for column in self._told]
            infos[name] = dict(zip(info_names(name), values, strict=True))
            both = [name]
            if FOLLOWER.name in self._names:
                follower = self._names[FOLLOWER.name][command]
                both.append(follower)
                self._read_follower(slot, name, follower, result)
            if not is_over:
                agents += both
                self.slots.update(dict.fromkeys(both, slot))
        agents.sort(key=self._rank.__getitem__)
        return agents

    def _read_follower(self, slot: int, changer: str, name: str, result: Step) -> None:
        """Write the values of the driver behind the changer of a slot to the dicts."""
        observations, rewards, terminations, truncations, infos = result
        record = self._simulator.state.followers[0, slot]
        observations[name] = self._simulator.state.follower_observations[0, slot].copy()
        rewards[name] = float(record["reward"])
        terminations[name], truncations[name] = terminations[changer], truncations[changer]
        infos[name] = {
            "phase": infos[changer]["phase"],
            "is_paired": float(self._simulator.is_follower_acting[0, slot]),
            **dict(zip(FOLLOWER.reward_names, record["terms"].tolist(), strict=True)),
        }
