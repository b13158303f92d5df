"""Phases in which followers learn against changers, or a changer against followers."""

from collections.abc import Callable, Mapping, Sequence
from math import ceil
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np
import torch
from pydantic import Field

from marl_lanes.envs.batched import LaneChangeEnv
from marl_lanes.envs.followers import follower_policy
from marl_lanes.evaluation.driving import check_first_command
from marl_lanes.evaluation.metrics import evaluate
from marl_lanes.evaluation.recording import record_maneuvers
from marl_lanes.evaluation.rollout import Maneuver, check_episodes
from marl_lanes.extras import need
from marl_lanes.naf.checkpoint import CheckpointError, PolicyNetwork, greedy_policy
from marl_lanes.naf.network import NAFNetwork
from marl_lanes.scenario import Scenario, load_scenario
from marl_lanes.scenario.dispositions import LEARNED
from marl_lanes.traffic.roles.changer import CHANGER
from marl_lanes.traffic.roles.external import FollowerPolicy
from marl_lanes.traffic.roles.follower import FOLLOWER
from marl_lanes.training.algorithms.naf import NAF, NAFConfig
from marl_lanes.training.checkpoint import load_policy, make_network
from marl_lanes.training.collected import load_collected
from marl_lanes.training.config import ConfigError, EvaluationConfig, ProgramConfig, Widths
from marl_lanes.training.inputs import check_inputs, keep_inputs, read_scenario
from marl_lanes.training.learner import EvaluateModel, Learner
from marl_lanes.training.opponents import PoolPolicy, allot
from marl_lanes.training.run_folder import FINAL_MODEL, TIMES_FILE, check_empty
from marl_lanes.training.sizes import check_networks, check_sizes
from marl_lanes.training.torch_settings import take_resources

MODEL = f"checkpoints/{FINAL_MODEL}"
"""The trained policy in the folder of a phase."""
CHANGER_FILE = "initial_changer.pt"
"""A copy of the changer that a run begins with, in its folder."""


class ChangerEvaluationConfig(EvaluationConfig):
    """How good the changer is, meanwhile and at the end."""

    metrics: ClassVar[tuple[str, ...]] = (
        "success_rate",
        "completion_rate",
        "mean_episode_reward",
        "abort_rate",
        "missed_rate",
        "timed_out_rate",
        "collision_rate",
        "lost_after_rate",
        "collided_after_rate",
        "left_lane_after_rate",
        "mean_max_follower_braking_all",
    )


class ChangerConfig(NAFConfig):
    """How the changer learns."""

    evaluation: ChangerEvaluationConfig


class FollowerConfig(ChangerConfig):
    """How a follower learns."""

    hidden_sizes: Widths = Field(description="widths of the hidden layers of every network")


class InterplayConfig(ProgramConfig):
    """Fields of every program in which followers learn against a changer."""

    changer: str = Field(description="the checkpoint of the changer to learn against")
    follower: FollowerConfig


class Opponent(NamedTuple):
    """A changer that a follower learns against."""

    name: str
    network: PolicyNetwork
    share: float
    """Of the roads that it drives on."""


class Grounds:
    """What all phases of a run have in common: scenarios, seeds, devices, the first changer.

    Args:
        config: of the run.
        objective: what followers are paid for.
        guests: further changers' checkpoints, by the names of the run's copies.

    Raises:
        ScenarioError, CheckpointError, ConfigError: scenario and changer cannot be, or do not fit.
    """

    def __init__(
        self, config: InterplayConfig, objective: str, guests: Mapping[str, Path] | None = None
    ) -> None:
        self.config = config
        self.output = Path(config.output)
        self.is_new = config.resume is None
        self.files = {CHANGER_FILE: Path(config.changer), **(guests or {})}
        if self.is_new:
            check_empty(self.output)
        else:
            check_inputs(self.output, self.files)
        paid = {"followers": {"learned": {"objective": objective}}}
        self.scenario = (
            load_scenario(config.scenario, paid) if self.is_new else read_scenario(self.output)
        )
        self.training_scenario = load_collected(self.scenario, config.training_overrides)
        self._num_commands = check_episodes(self.scenario)
        part, num_features = config.follower, len(FOLLOWER.seen(self.scenario))
        name = "follower.hidden_sizes"
        check_networks(part, name, part.hidden_sizes, num_features, "follower.")
        self.check_learner("follower", part)
        self.device = take_resources(config)

    def find_changer(self, name: str = CHANGER_FILE) -> Path:
        """A changer's checkpoint; the run's own copy once it is there.

        Args:
            name: of the copy.
        """
        kept = self.output / name
        return self.files[name] if self.is_new and not kept.exists() else kept

    def load_changer(
        self,
        field: str = "changer",
        name: str = CHANGER_FILE,
        scenario: Scenario | None = None,
        load: Callable[[Path, Scenario], Any] = load_policy,
    ) -> Any:
        """The network of a changer that the run was given.

        Args:
            field: of the configuration, for messages.
            name: of the run's copy.
            scenario: that it must fit; None: that of the run.
            load: reads a checkpoint that fits a scenario.

        Raises:
            ConfigError: it cannot be read, or does not fit the scenario.
        """
        try:
            return load(self.find_changer(name), scenario or self.scenario).network
        except CheckpointError as error:
            given = str(self.files[name])
            raise ConfigError(f"{field} = {given!r}: {error}") from None

    def check_learner(self, name: str, part: ChangerConfig) -> None:
        """Refuse what does not fit in memory, what cannot record, and too short a horizon.

        Args:
            name: of the section, for messages.
            part: the section.

        Raises:
            ScenarioError, ValueError, MissingExtraError: it cannot be.
        """
        check_sizes(part, self.training_scenario, self.scenario, f"{name}.")
        if part.evaluation.record:
            need("pyarrow", "view")
        num_roads = ceil(part.evaluation.num_maneuvers / self._num_commands)
        check_first_command(self.scenario, num_roads, part.evaluation.saved_models_seed)

    def keep_inputs(self) -> None:
        """Write what a resumed run reads."""
        self.scenario = keep_inputs(self.output, self.config, self.scenario, self.files)

    def seed(self, phase: int) -> int:
        """Seed torch for the phase, whatever was drawn before it; also the seed of its traffic."""
        seed = int(np.random.SeedSequence([self.config.seed, phase]).generate_state(1)[0])
        torch.manual_seed(seed)
        return seed


class Phase(NamedTuple):
    """A learner, made when it is needed, and how its saved models are evaluated."""

    make_learner: Callable[[], Learner]
    evaluate_model: EvaluateModel


def follower_phase(grounds: Grounds, opponents: Sequence[Opponent], *, number: int) -> Phase:
    """An untrained follower that learns against frozen changers.

    Args:
        grounds: of the run.
        opponents: changers, each on its share of the roads.
        number: of the phase; its seed comes from it.
    """
    config = grounds.config.follower
    shares = [opponent.share for opponent in opponents]
    alone = load_scenario(grounds.scenario, {"followers": {"mix": {LEARNED: 1.0}}})

    def make() -> Learner:
        env = LaneChangeEnv(
            grounds.training_scenario,
            config.collector.num_envs,
            seed=grounds.seed(number),
            learned_followers=True,
        )
        network = make_network(grounds.scenario, "mlp", config.hidden_sizes, role=FOLLOWER)
        algorithm = NAF(
            config,
            env,
            network,
            group=FOLLOWER.group,
            device=grounds.device,
            acting_device=grounds.device,
        )
        drivers = [opponent.network.policy().module for opponent in opponents]
        num_roads = allot(shares, config.collector.num_envs).tolist()
        others = PoolPolicy(drivers, num_roads, len(CHANGER.act(grounds.scenario)))
        return Learner(config, env, algorithm, others=[others])

    def evaluate_model(network: PolicyNetwork, recorded: Path | None) -> Mapping[str, Any]:
        policies = {LEARNED: follower_policy(network)}
        maneuvers: list[Maneuver] = []
        for opponent, number in zip(
            opponents, allot(shares, config.evaluation.num_maneuvers).tolist(), strict=True
        ):
            if number:
                maneuvers += record_maneuvers(
                    None if maneuvers else recorded,
                    opponent.name,
                    alone,
                    greedy_policy(opponent.network),
                    number,
                    seed=config.evaluation.saved_models_seed,
                    roads=[0],
                    follower_policies=policies,
                )
        return evaluate(maneuvers, alone, with_optimum=False)

    return Phase(make, evaluate_model)


def changer_phase(
    grounds: Grounds,
    config: ChangerConfig,
    load_changer: Callable[[], NAFNetwork],
    mix: Mapping[str, float],
    policies: Mapping[str, FollowerPolicy],
    *,
    number: int,
) -> Phase:
    """A changer that learns on among frozen followers.

    Args:
        grounds: of the run.
        config: how it learns.
        load_changer: reads the network that it begins with.
        mix: shares of the followers.
        policies: of those in the mix that are neither scripted nor registered.
        number: of the phase; its seed comes from it.
    """
    overrides = {"followers": {"mix": {name: share for name, share in mix.items() if share > 0.0}}}
    mixed = load_scenario(grounds.scenario, overrides)

    def make() -> Learner:
        env = LaneChangeEnv(
            grounds.training_scenario,
            config.collector.num_envs,
            seed=grounds.seed(number),
            overrides=overrides,
            follower_policies=policies,
        )
        algorithm = NAF(
            config, env, load_changer(), device=grounds.device, acting_device=grounds.device
        )
        return Learner(config, env, algorithm)

    def evaluate_model(network: PolicyNetwork, recorded: Path | None) -> Mapping[str, Any]:
        maneuvers = record_maneuvers(
            recorded,
            "" if recorded is None else f"checkpoints/{recorded.stem}.pt",
            mixed,
            greedy_policy(network),
            config.evaluation.num_maneuvers,
            seed=config.evaluation.saved_models_seed,
            roads=[0],
            follower_policies=policies,
        )
        return evaluate(maneuvers, mixed, with_optimum=False)

    return Phase(make, evaluate_model)


def carry_out(
    phase: Phase,
    folder: Path,
    *,
    is_begun: bool,
    keep_inputs: Callable[[], object] | None = None,
) -> bool:
    """Bring a phase to its end, from where it is; False when interrupted.

    Args:
        phase: what learns.
        folder: of the phase.
        is_begun: whether its training state must be there.
        keep_inputs: as for ``Learner.begin``.
    """
    if (folder / TIMES_FILE).exists():
        return True
    learner = phase.make_learner()
    if is_begun:
        learner.resume(folder)
    else:
        learner.begin(folder, keep_inputs)
    try:
        return learner.train(phase.evaluate_model)
    finally:
        learner.close()
