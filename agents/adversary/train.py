"""Train followers against a lane changer, and the changer against them in turn.

python agents/adversary/train.py changer=CHECKPOINT [scenario=NAME]
    [objective=adversarial|cooperative] [rounds=K] [seed=N] [output=DIR] [resume=RUN]
    [any field of the config]

With rounds=0 one follower learns against the changer. With rounds=K followers and changer
take turns, K times; the changer learns against all followers so far.
"""

import shutil
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import closing
from math import ceil
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np
import torch
from pydantic import Field, field_validator
from tqdm import tqdm

from marl_lanes import LaneChangeEnv, NAFNetwork, Scenario, load_scenario
from marl_lanes.envs.followers import follower_policy, load_follower
from marl_lanes.evaluation.crossplay import crossplay
from marl_lanes.evaluation.driving import Policy, check_first_command
from marl_lanes.evaluation.metrics import evaluate
from marl_lanes.evaluation.recording import record_maneuvers
from marl_lanes.evaluation.rollout import check_episodes
from marl_lanes.evaluation.tables import format_crossplay
from marl_lanes.extras import need
from marl_lanes.files import copy_file, write_json
from marl_lanes.naf.checkpoint import CheckpointError, PolicyNetwork, greedy_policy
from marl_lanes.scenario.fields import NonNegative
from marl_lanes.scenario.followers import LEARNED, SCRIPTED
from marl_lanes.terminal import lenient_streams
from marl_lanes.traffic.roles.external import FollowerPolicy
from marl_lanes.traffic.roles.follower import FOLLOWER
from marl_lanes.training.algorithms.naf import NAF, NAFConfig
from marl_lanes.training.checkpoint import load_checkpoint, make_network
from marl_lanes.training.collected import load_collected
from marl_lanes.training.command_line import read_command_line, refusing
from marl_lanes.training.config import (
    ConfigError,
    CountOrZero,
    EvaluationConfig,
    ProgramConfig,
    Widths,
    read_config,
)
from marl_lanes.training.failures import ending
from marl_lanes.training.inputs import SUMS_FILE, check_inputs, keep_inputs, read_scenario
from marl_lanes.training.learner import EvaluateModel, Learner
from marl_lanes.training.run_folder import (
    FINAL_MODEL,
    STATE_FILE,
    TIMES_FILE,
    check_empty,
    lock_run,
)
from marl_lanes.training.sizes import check_networks, check_sizes
from marl_lanes.training.transitions import LivePolicy

MODEL = f"checkpoints/{FINAL_MODEL}"
"""The trained policy in the folder of a phase."""
CHANGER_FILE = "initial_changer.pt"
"""A copy of the changer to learn against, in the run folder."""
FOLDER = Path(__file__).parent


class ChangerEvaluationConfig(EvaluationConfig):
    """How good the changer is, meanwhile and at the end."""

    metrics: ClassVar[tuple[str, ...]] = (
        "success_rate",
        "completion_rate",
        "mean_episode_reward",
        "abort_rate",
        "missed_rate",
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


class AdversaryConfig(ProgramConfig):
    """Everything that defines a run."""

    changer: str = Field(description="the checkpoint of the changer to learn against")
    objective: Literal["adversarial", "cooperative"] = Field(
        description="what the followers are paid for: adversarial or cooperative"
    )
    rounds: CountOrZero = Field(
        description="how often follower and changer take turns; 0: one follower learns, the "
        "changer does not"
    )
    scripted: dict[str, NonNegative] = Field(
        description="shares of scripted dispositions while the changer learns; the followers share "
        "the rest"
    )
    follower: FollowerConfig
    hardening: ChangerConfig

    @field_validator("scripted")
    @classmethod
    def _check_scripted(cls, shares: dict[str, float]) -> dict[str, float]:
        unknown = [name for name in shares if name not in SCRIPTED]
        if unknown:
            raise ValueError(f"{unknown[0]!r} must be among {', '.join(SCRIPTED)}")
        if sum(shares.values()) >= 1.0:
            raise ValueError("must be below 1 in all")
        return shares


@lenient_streams()
def main(arguments: Sequence[str] | None = None) -> None:
    """Train, evaluate, report."""
    with refusing():
        config = read(arguments)
        run = Run(config)
    with ending(run.output):
        result = run.take_turns() if config.rounds else run.train_one_follower()
    if result is None:
        print(f"interrupted; continue with resume={config.output}")
        return
    print(f"run folder: {config.output}\n\n{format_crossplay(result)}")


def read(arguments: Sequence[str] | None = None) -> AdversaryConfig:
    """The configuration of the command line and config.yaml."""
    fields = read_command_line(AdversaryConfig, FOLDER, str(__doc__), arguments)
    return read_config(AdversaryConfig, fields)


class Run:
    """The phases of a run, each in a folder from which it can go on, and what comes of them.

    Raises:
        ScenarioError, CheckpointError, ConfigError: scenario and changer cannot be, or do not fit.
    """

    def __init__(self, config: AdversaryConfig) -> None:
        self.config = config
        self.output = Path(config.output)
        self.device = torch.device(config.device)
        is_new = config.resume is None
        self.changer = Path(config.changer)
        if is_new:
            check_empty(self.output)
        else:
            check_inputs(self.output, [CHANGER_FILE])
        objective = {"followers": {"learned": {"objective": config.objective}}}
        self.scenario = (
            load_scenario(config.scenario, objective) if is_new else read_scenario(self.output)
        )
        self.training_scenario = load_collected(self.scenario, config.training_overrides)
        self._check(check_episodes(self.scenario))

    def _check(self, num_commands: int) -> None:
        """Refuse what does not fit in memory, a changer that is none, and too short a horizon."""
        config = self.config
        widths, num_features = config.follower.hidden_sizes, len(FOLLOWER.seen(self.scenario))
        name = "follower.hidden_sizes"
        check_networks(config.follower, name, widths, num_features, "follower.")
        parts: dict[str, ChangerConfig] = {"follower": config.follower}
        if config.rounds:
            parts["hardening"] = config.hardening
        for name, part in parts.items():
            check_sizes(part, self.training_scenario, self.scenario, f"{name}.")
        try:
            self._load_changer(self.changer)
        except CheckpointError as error:
            raise ConfigError(f"changer = {config.changer!r}: {error}") from None
        torch.set_num_threads(config.num_threads)
        for part in parts.values():
            if part.evaluation.record:
                need("pyarrow", "view")
            num_roads = ceil(part.evaluation.num_maneuvers / num_commands)
            check_first_command(self.scenario, num_roads, part.evaluation.saved_models_seed)

    @property
    def _kept_changer(self) -> Path:
        return self.output / CHANGER_FILE

    def _load_changer(self, path: Path) -> NAFNetwork:
        """A changer's network. That to learn against is read from the run's copy once it is there.

        Raises:
            CheckpointError: it cannot be read, or does not fit the scenario.
        """
        if path == self.changer and self._kept_changer.exists():
            path = self._kept_changer
        return load_checkpoint(path, self.scenario).network

    def _keep_inputs(self) -> None:
        files = {CHANGER_FILE: self.changer}
        self.scenario = keep_inputs(self.output, self.config, self.scenario, files)

    def train_one_follower(self) -> dict[str, Any] | None:
        """A follower, and its comparison with the scripted ones; None when interrupted."""
        if not self._train_follower(self.output, self.changer, phase=0):
            return None
        checkpoint = str(self.output / MODEL)
        learned = {"mix": {LEARNED: 1.0}, "learned": {"checkpoint": checkpoint}}
        result = self._compare(
            {"changer": self.changer},
            {LEARNED: learned, **_alone(SCRIPTED)},
            self.config.follower.evaluation,
        )
        write_json(self.output / "evaluation.json", result)
        return result

    def take_turns(self) -> dict[str, Any] | None:
        """The changer hardened against its followers, and its report; None when interrupted."""
        with closing(lock_run(self.output)):
            if self.config.resume is None:
                check_empty(self.output)
            return self._take_turns()

    def _take_turns(self) -> dict[str, Any] | None:
        changer, pool = self.changer, dict[str, FollowerPolicy]()
        for turn in range(self.config.rounds):
            folder = self.output / f"round_{turn + 1}"
            name = f"pool_{turn + 1}"
            if not self._train_follower(folder / "follower", changer, phase=2 * turn):
                return None
            follower = folder / "follower" / MODEL
            copy_file(follower, self.output / "pool" / f"{name}.pt")
            pool[name] = load_follower(follower, self.scenario)
            if not self._train_changer(folder / "changer", changer, pool, phase=2 * turn + 1):
                return None
            changer = folder / "changer" / MODEL
        copy_file(changer, self.output / "changer.pt")
        result = self._compare(
            {"unhardened": self.changer, "hardened": changer},
            _alone([*SCRIPTED, *pool]),
            self.config.hardening.evaluation,
            pool,
        )
        write_json(self.output / "report.json", result)
        return result

    def _train_follower(self, folder: Path, changer: Path, *, phase: int) -> bool:
        """Train a follower of its own against the frozen changer."""
        config = self.config.follower
        driver = self._load_changer(changer)
        scenario = load_scenario(self.scenario, {"followers": {"mix": {LEARNED: 1.0}}})

        def make() -> Learner:
            seed = self._seed(phase)
            env = LaneChangeEnv(
                self.training_scenario,
                config.collector.num_envs,
                seed=seed,
                learned_followers=True,
            )
            algorithm = NAF(
                config,
                env,
                make_network(self.scenario, "mlp", config.hidden_sizes, role=FOLLOWER),
                group=FOLLOWER.group,
                device=self.device,
                acting_device=self.device,
            )
            others = [LivePolicy(driver.policy().module, driver.action_dim)]
            return Learner(config, env, algorithm, others=others)

        def evaluate_model(network: PolicyNetwork, recorded: Path | None) -> Mapping[str, Any]:
            policies = {LEARNED: follower_policy(network)}
            return _evaluate(
                scenario, greedy_policy(driver), policies, config.evaluation, changer, recorded
            )

        return self._train(folder, make, evaluate_model)

    def _train_changer(
        self, folder: Path, changer: Path, pool: Mapping[str, FollowerPolicy], *, phase: int
    ) -> bool:
        """Train the changer on among the frozen followers of the pool and the scripted ones."""
        config = self.config.hardening
        scripted = self.config.scripted
        share = (1.0 - sum(scripted.values())) / len(pool)
        mix = {"followers": {"mix": dict.fromkeys(pool, share) | scripted}}
        scenario = load_scenario(self.scenario, mix)

        def make() -> Learner:
            seed = self._seed(phase)
            env = LaneChangeEnv(
                self.training_scenario,
                config.collector.num_envs,
                seed=seed,
                overrides=mix,
                follower_policies=pool,
            )
            network = self._load_changer(changer)
            algorithm = NAF(config, env, network, device=self.device, acting_device=self.device)
            return Learner(config, env, algorithm)

        def evaluate_model(network: PolicyNetwork, recorded: Path | None) -> Mapping[str, Any]:
            return _evaluate(
                scenario, greedy_policy(network), pool, config.evaluation, folder, recorded
            )

        return self._train(folder, make, evaluate_model)

    def _train(
        self, folder: Path, make: Callable[[], Learner], evaluate_model: EvaluateModel
    ) -> bool:
        """Bring the phase to its end, from where it is; False when interrupted."""
        if (folder / TIMES_FILE).exists():
            return True
        learner = make()
        is_begun = (folder / STATE_FILE).exists()
        if folder == self.output:
            is_begun |= self.config.resume is not None
        elif not is_begun:
            # What a phase has left that was killed before its first training state.
            shutil.rmtree(folder, ignore_errors=True)
        if is_begun:
            learner.resume(folder)
        else:
            is_first = not (self.output / SUMS_FILE).exists()
            learner.begin(folder, self._keep_inputs if is_first else None)
        print(f"{folder}:", file=sys.stderr)
        try:
            return learner.train(evaluate_model)
        finally:
            learner.close()

    def _seed(self, phase: int) -> int:
        """Seed torch for the phase, whatever was drawn before it; also the seed of its traffic."""
        seed = int(np.random.SeedSequence([self.config.seed, phase]).generate_state(1)[0])
        torch.manual_seed(seed)
        return seed

    def _compare(
        self,
        changers: Mapping[str, Path],
        followers: Mapping[str, Mapping[str, Any]],
        settings: EvaluationConfig,
        policies: Mapping[str, FollowerPolicy] | None = None,
    ) -> dict[str, Any]:
        """Every changer against every kind of follower."""
        networks = {label: self._load_changer(path) for label, path in changers.items()}
        number = settings.final_num_maneuvers
        total = number * len(changers) * len(followers)
        with tqdm(total=total, unit="maneuver", desc="evaluating") as bar:
            result = crossplay(
                {name: (self.scenario, greedy_policy(one)) for name, one in networks.items()},
                followers,
                number,
                seed=settings.seed,
                follower_policies=policies,
                progress=lambda count: bar.update(count - bar.n),
            )
        checkpoints = {label: str(path) for label, path in changers.items()}
        return {"objective": self.config.objective, "checkpoints": checkpoints, **result}


def _evaluate(
    scenario: Scenario,
    policy: Policy,
    policies: Mapping[str, FollowerPolicy],
    settings: EvaluationConfig,
    name: Path,
    recorded: Path | None,
) -> dict[str, Any]:
    """What the changer achieves among the followers, in short."""
    maneuvers = record_maneuvers(
        recorded,
        str(name),
        scenario,
        policy,
        settings.num_maneuvers,
        seed=settings.saved_models_seed,
        roads=[0],
        follower_policies=policies,
    )
    return evaluate(maneuvers, scenario, with_optimum=False)


def _alone(dispositions: Iterable[str]) -> dict[str, dict[str, Any]]:
    """Overrides of the followers by label: each disposition, and no other."""
    return {name: {"mix": {name: 1.0}} for name in dispositions}


if __name__ == "__main__":
    main()
