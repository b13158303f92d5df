"""Changers and followers in a league: each generation learns against all that were before.

python agents/adversary/league.py changer=CHECKPOINT [scenario=NAME] [generations=N]
    [followers=[NAME,...]] [held_out=[NAME,...]] [+guests.NAME=CHANGER[@SCENARIO] ...]
    [seed=N] [output=DIR] [resume=RUN]
    [any field of the config]

In each generation an untrained follower learns against the changers of the pool, then a changer
among the followers of the pool. Whom the learner loses to, it meets more often.
At the end all are rated from their matches.
"""

import csv
import io
import json
import shutil
import sys
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import asdict
from itertools import product
from math import ceil
from pathlib import Path
from typing import Annotated, Any, Self

from pydantic import Field, model_validator
from tqdm import tqdm

from marl_lanes import Scenario, load_scenario
from marl_lanes.cli.policies import UNTRAINED, make_policy
from marl_lanes.envs.followers import load_follower
from marl_lanes.evaluation.crossplay import compose_result, describe_pair, drive_pairs
from marl_lanes.evaluation.driving import Policy
from marl_lanes.evaluation.figures import draw_crossplay
from marl_lanes.evaluation.intervals import CONFIDENCE
from marl_lanes.evaluation.rating import Match, Tally, rate, tally
from marl_lanes.evaluation.rating_figure import draw_ratings
from marl_lanes.evaluation.rollout import check_episodes
from marl_lanes.evaluation.style import FORMATS
from marl_lanes.evaluation.tables import format_ratings
from marl_lanes.files import copy_file, write_json, write_text
from marl_lanes.interplay import (
    MODEL,
    ChangerConfig,
    Grounds,
    InterplayConfig,
    Opponent,
    Phase,
    carry_out,
    changer_phase,
    follower_phase,
)
from marl_lanes.naf.checkpoint import greedy_policy
from marl_lanes.naf.network import NAFNetwork
from marl_lanes.scenario import list_scenarios
from marl_lanes.scenario.fields import Real
from marl_lanes.scenario.followers import DispositionName
from marl_lanes.scenario.messages import shown
from marl_lanes.terminal import lenient_streams
from marl_lanes.traffic.roles.external import FollowerPolicy, choose_policies
from marl_lanes.training.checkpoint import load_checkpoint
from marl_lanes.training.command_line import read_command_line, refusing
from marl_lanes.training.config import ConfigError, EvaluationConfig, Number, read_config
from marl_lanes.training.failures import ending
from marl_lanes.training.opponents import prioritise
from marl_lanes.training.run_folder import STATE_FILE, TIMES_FILE, check_empty, lock_run

FOLDER = Path(__file__).parent
FIRST = "changer_0"
"""The given changer."""

Changer = tuple[Scenario, Policy]
"""Where it drives, and how."""


class LeagueConfig(InterplayConfig):
    """Everything that defines a league."""

    generations: Number = Field(
        le=1000, description="how often a new follower learns, and then a new changer"
    )
    followers: Annotated[list[DispositionName], Field(min_length=1, max_length=32)] = Field(
        description="names of the followers that the pool begins with; the last one stands for the "
        "learner when the first follower's opponents are drawn"
    )
    held_out: Annotated[list[DispositionName], Field(max_length=32)] = Field(
        description="names of followers that are rated, and never learned against"
    )
    guests: Annotated[dict[DispositionName, str], Field(max_length=32)] = Field(
        description="other changers, by name: a checkpoint of any algorithm, or the name of a "
        "policy without learning, each with @SCENARIO if it drives on another shipped one; rated, "
        "never learned against"
    )
    exponent: Real = Field(
        ge=0.0,
        le=100.0,
        description="the larger, the more a learner meets those that it loses to; 0: all alike",
    )
    continues: bool = Field(
        strict=True,
        description="whether a new changer goes on from the newest one; false: it begins "
        "untrained, with the same structure",
    )
    hardening: ChangerConfig

    @model_validator(mode="after")
    def _check_names(self) -> Self:
        names = [*self.followers, *self.held_out]
        for name in names:
            if names.count(name) > 1:
                raise ValueError(f"{name!r} must be once in followers and held_out together")
        for name in self.guests:
            if name in names or name.partition("_")[0] in ("changer", "follower"):
                raise ValueError(f"guests: {name!r} must not be the name of another player")
        return self


@lenient_streams()
def main(arguments: Sequence[str] | None = None) -> None:
    """Train all generations, rate them."""
    with refusing():
        config = read(arguments)
        league = League(config)
    with ending(league.output), closing(lock_run(league.output)):
        rows = league.play()
    if rows is None:
        print(f"interrupted; continue with resume={config.output}")
        return
    print(f"run folder: {config.output}\n\n{format_ratings(rows)}")


def read(arguments: Sequence[str] | None = None) -> LeagueConfig:
    """The configuration of the command line and league.yaml."""
    fields = read_command_line(LeagueConfig, FOLDER, str(__doc__), arguments, file="league")
    return read_config(LeagueConfig, fields)


class League:
    """The pool, its matches, and the phases that add to it, each in a folder of its own.

    Raises:
        ScenarioError, CheckpointError, ConfigError: scenario, changer or a follower cannot be.
    """

    def __init__(self, config: LeagueConfig) -> None:
        self.config = config
        sources = {name: given.partition("@")[0] for name, given in config.guests.items()}
        files = {_copy(name): Path(what) for name, what in sources.items() if what not in UNTRAINED}
        self.grounds = Grounds(config, "adversarial", files)
        self.grounds.check_learner("hardening", config.hardening)
        self.output = self.grounds.output
        self.followers = list(config.followers)
        for field in ("followers", "held_out"):
            for name in getattr(config, field):
                self._check_follower(field, name)
        self.changers = {FIRST: self.grounds.load_changer(load=load_checkpoint)}
        self.guests = {name: self._invite(name, what) for name, what in sources.items()}
        self.policies: dict[str, FollowerPolicy] = {}
        self.matches = Matches(self.grounds, config.hardening.evaluation)

    def _check_follower(self, field: str, name: str) -> None:
        """Refuse one that the scenario cannot have, or that has no policy."""
        try:
            alone = load_scenario(self.grounds.scenario, {"followers": _alone(name)})
            choose_policies(alone, None, has_learner=False)
        except ValueError as error:
            raise ConfigError(f"{field} = {shown(name)}: {error}") from None

    def _invite(self, name: str, what: str) -> Changer:
        """A guest, on its scenario."""
        field, (_, _, place) = f"guests.{name}", self.config.guests[name].partition("@")
        if place and place not in list_scenarios():
            raise ConfigError(
                f"{field} = {shown(self.config.guests[name])}: @SCENARIO must be a shipped one: "
                f"{', '.join(list_scenarios())}"
            )
        scenario = load_scenario(place) if place else self.grounds.scenario
        if check_episodes(scenario) != check_episodes(self.grounds.scenario):
            raise ConfigError(
                f"{field} = {shown(self.config.guests[name])}: num_agents of its scenario must be "
                f"{self.grounds.scenario.num_agents}, as on that of the league"
            )
        if what in UNTRAINED:
            return scenario, make_policy(what, scenario, self.config.seed)
        return scenario, greedy_policy(self.grounds.load_changer(field, _copy(name), scenario))

    def play(self) -> list[dict[str, Any]] | None:
        """All generations, and the ratings; None when interrupted."""
        if self.grounds.is_new:
            check_empty(self.output)
            try:
                self.grounds.keep_inputs()
            except BaseException:
                shutil.rmtree(self.output)
                raise
        for generation in range(1, self.config.generations + 1):
            for play in (self._add_follower, self._add_changer):
                self.matches.hold(self._learners(), self.followers, self.policies)
                if not play(generation):
                    return None
        everybody = [*self.followers, *self.config.held_out]
        self.matches.hold({**self._learners(), **self.guests}, everybody, self.policies)
        return self._report()

    def _learners(self) -> dict[str, Changer]:
        """The changers of the pool."""
        scenario = self.grounds.scenario
        return {name: (scenario, greedy_policy(one)) for name, one in self.changers.items()}

    def _add_follower(self, generation: int) -> bool:
        """A follower of its own against the frozen changers; False when interrupted."""
        newest = self.followers[-1]
        won = [self.matches.shares(changer, newest)[1] for changer in self.changers]
        shares = prioritise(won, self.config.exponent).tolist()
        opponents = [
            Opponent(name, self.changers[name], share)
            for name, share in zip(self.changers, shares, strict=True)
        ]
        phase = follower_phase(self.grounds, opponents, number=2 * generation - 2)
        name = f"follower_{generation}"
        met = dict(zip(self.changers, shares, strict=True))
        if not self._train(phase, name, met):
            return False
        self.policies[name] = load_follower(self._pooled(name), self.grounds.scenario)
        self.followers.append(name)
        return True

    def _add_changer(self, generation: int) -> bool:
        """A changer that learns among the frozen followers; False when interrupted."""
        newest = list(self.changers)[-1]
        won = [self.matches.shares(newest, follower)[0] for follower in self.followers]
        shares = prioritise(won, self.config.exponent).tolist()
        mix = dict(zip(self.followers, shares, strict=True))
        path = self.grounds.find_changer() if newest == FIRST else self._pooled(newest)

        def begin() -> NAFNetwork:
            network = load_checkpoint(path, self.grounds.scenario).network
            return network if self.config.continues else NAFNetwork(**network.config)

        phase = changer_phase(
            self.grounds,
            self.config.hardening,
            begin,
            mix,
            self.policies,
            number=2 * generation - 1,
        )
        name = f"changer_{generation}"
        if not self._train(phase, name, mix):
            return False
        network = load_checkpoint(self._pooled(name), self.grounds.scenario).network
        self.changers[name] = network
        return True

    def _train(self, phase: Phase, name: str, met: Mapping[str, float]) -> bool:
        folder = self.output / name
        is_begun = (folder / STATE_FILE).exists()
        if not is_begun and not (folder / TIMES_FILE).exists():
            # What a phase has left that was killed before its first training state.
            shutil.rmtree(folder, ignore_errors=True)
        print(f"{folder}:", file=sys.stderr)
        if not carry_out(phase, folder, is_begun=is_begun):
            return False
        write_json(folder / "opponents.json", dict(met))
        copy_file(folder / MODEL, self._pooled(name))
        return True

    def _pooled(self, name: str) -> Path:
        return self.output / "pool" / f"{name}.pt"

    def _report(self) -> list[dict[str, Any]]:
        """Write ratings, cross-play and their figures."""
        followers = [*self.followers, *self.config.held_out]
        seed = self.config.hardening.evaluation.seed
        rows = [
            {
                **asdict(rating),
                "generation": self._generation(rating.player),
                "is_held_out": rating.player in (*self.config.held_out, *self.guests),
            }
            for rating in rate(self.matches.played, seed=seed)
        ]
        number = self.config.hardening.evaluation.final_num_maneuvers
        told = {"num_maneuvers": number, "seed": seed, "confidence": CONFIDENCE, "ratings": rows}
        write_json(self.output / "ratings.json", told)
        text = io.StringIO()
        writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
        write_text(self.output / "ratings.csv", text.getvalue())
        everybody = {**self._learners(), **self.guests}
        names = {name: scenario.name for name, (scenario, _) in everybody.items()}
        overrides = {name: _alone(name) for name in followers}
        result = compose_result(names, overrides, self.matches.pairs, number, seed)
        write_json(self.output / "crossplay.json", result)
        draw_ratings([self.output / f"ratings.{kind}" for kind in FORMATS], [told])
        draw_crossplay([self.output / f"crossplay.{kind}" for kind in FORMATS], result)
        return rows

    def _generation(self, player: str) -> int | None:
        """The generation of a trained player; of the given changer 0; of all others None."""
        is_named = player in (*self.config.followers, *self.config.held_out, *self.guests)
        return None if is_named else int(player.rpartition("_")[2])


class Matches:
    """All that were held, in a file of the run's folder, which is written after each one.

    Args:
        grounds: of the run.
        settings: number of maneuvers and seed, those of a final evaluation.

    Raises:
        ConfigError: the file of a run to resume is damaged.
    """

    def __init__(self, grounds: Grounds, settings: EvaluationConfig) -> None:
        self._grounds, self._settings = grounds, settings
        self._path = grounds.output / "matches.json"
        self._held: dict[tuple[str, str], dict[str, Any]] = {}
        if grounds.is_new or not self._path.exists():
            return
        try:
            for held in json.loads(self._path.read_text(encoding="utf-8")):
                pair, roads = held["pair"], [Tally(*map(int, road)) for road in held["roads"]]
                self._held[pair["changer"], pair["followers"]] = {"pair": pair, "roads": roads}
        except (ValueError, TypeError, LookupError):
            raise ConfigError(
                f"resume = {str(grounds.output)!r}: its {self._path.name} is damaged: remove it, "
                "and the matches are held again"
            ) from None

    @property
    def played(self) -> list[Match]:
        """For ``rate``."""
        return [Match(*names, held["roads"]) for names, held in self._held.items()]

    @property
    def pairs(self) -> list[dict[str, Any]]:
        """For ``compose_result``."""
        return [held["pair"] for held in self._held.values()]

    def shares(self, changer: str, follower: str) -> tuple[float, ...]:
        """Shares of maneuvers that the changer won, the follower won, nobody won."""
        total = Match(changer, follower, self._held[changer, follower]["roads"]).total
        return tuple(part / sum(total) for part in total)

    def hold(
        self,
        changers: Mapping[str, Changer],
        followers: Sequence[str],
        policies: Mapping[str, FollowerPolicy],
    ) -> None:
        """Drive every pair that has not met.

        Args:
            changers: by name, each on its scenario.
            followers: names.
            policies: of those that have learned, by name.
        """
        number, seed = self._settings.final_num_maneuvers, self._settings.seed
        due = [pair for pair in product(changers, followers) if pair not in self._held]
        num_roads = ceil(number / check_episodes(self._grounds.scenario))
        for changer, follower in tqdm(due, unit="match", desc="matches"):
            (pair,) = drive_pairs(
                {changer: changers[changer]},
                {follower: _alone(follower)},
                number,
                seed=seed,
                follower_policies=policies,
            )
            self._held[changer, follower] = {
                "pair": describe_pair(pair, seed=seed),
                "roads": tally(pair.maneuvers, pair.scenario, num_roads),
            }
            write_json(self._path, list(self._held.values()))


def _copy(guest: str) -> str:
    """File name of the run's copy of a guest's checkpoint."""
    return f"guest_{guest}.pt"


def _alone(name: str) -> dict[str, Any]:
    """Overrides of ``followers``: this disposition, and no other."""
    return {"mix": {name: 1.0}}


if __name__ == "__main__":
    main()
