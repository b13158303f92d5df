"""A training of the shared NAF policy from its command line to its report.

``marl-lanes train`` and ``agents/naf/train.py`` are this.
"""

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path

import torch

from marl_lanes import LaneChangeEnv, NAFNetwork, Scenario, ScenarioError, load_scenario
from marl_lanes.evaluation.policies import (
    make_anticipating_cascade_policy,
    make_assertive_cascade_policy,
    make_mpc_policy,
)
from marl_lanes.experiment import run, start
from marl_lanes.naf.checkpoint import CheckpointError
from marl_lanes.naf.encoder import make_encoder
from marl_lanes.recipes import FOLDER
from marl_lanes.terminal import lenient_streams
from marl_lanes.traffic.roles.changer import CHANGER
from marl_lanes.training.algorithms.naf import NAF, TrainingConfig
from marl_lanes.training.checkpoint import load_checkpoint, make_network
from marl_lanes.training.command_line import Fields, describe_command, read_command_line, refusing
from marl_lanes.training.config import ConfigError, read_changers_config
from marl_lanes.training.demonstrations import Expert, learn_from_expert
from marl_lanes.training.sizes import check_networks

EXPERTS = {
    "mpc": make_mpc_policy,
    "assertive-cascade": make_assertive_cascade_policy,
    "anticipating-cascade": make_anticipating_cascade_policy,
}
"""That demonstrate."""

DESCRIPTION = """\
Train the shared NAF policy of all lane changers, evaluate it, write its report.

A recipe has values for all fields: fast (two minutes), long (nearer to the
optimum), interactive or paper. A scenario with two actions gets the recipe
interactive, others the recipe fast.

examples:
  %(prog)s output=runs/first seed=1
  %(prog)s scenario=interactive output=runs/interactive
  %(prog)s recipe=paper scenario=touch output=runs/touch
  %(prog)s network.mu=damped loss.gamma=0.99 output=runs/damped
  %(prog)s scenario=dense initial_checkpoint=zoo:paper \\
      demonstrations.num_transitions=0 output=runs/dense
  %(prog)s collector=multi num_workers=4 output=runs/four
  %(prog)s resume=runs/first
"""


@lenient_streams()
def train(program: str, arguments: Sequence[str] | None = None) -> None:
    """Train, evaluate, report.

    Args:
        program: how the program is called.
        arguments: its command line; None: that of this process.
    """
    with refusing():
        config = read(arguments, program)
        command = describe_command(program, arguments)
        learner, scenario = start(config, partial(make_algorithm, config), command)
    run(learner, config, scenario)


def read(arguments: Sequence[str] | None = None, program: str | None = None) -> TrainingConfig:
    """The configuration of the command line and the YAML files.

    Args:
        arguments: the command line; None: that of this process.
        program: how the program is called, for its help.

    Raises:
        ConfigError, ScenarioError: the configuration cannot be.
    """
    fields = read_command_line(
        TrainingConfig,
        FOLDER,
        DESCRIPTION,
        arguments,
        {"recipe": choose_recipe},
        program=program,
    )
    return read_changers_config(TrainingConfig, fields)


def choose_recipe(fields: Fields) -> str:
    """The recipe for the scenario, if the command line names none."""
    name = fields["scenario"]
    if isinstance(name, Mapping | list) or name is None:
        return "fast"  # which is refused later
    scenario = load_scenario(str(name))
    return "fast" if scenario.action.longitudinal is None else "interactive"


def make_algorithm(
    config: TrainingConfig,
    env: LaneChangeEnv,
    scenario: Scenario,
    device: torch.device,
    acting_device: torch.device,
) -> NAF:
    """NAF with the network that the training starts from."""
    network = start_network(config, scenario)
    # A run that is resumed has weights of its own.
    if config.demonstrations.num_transitions and config.resume is None:
        learn_from_expert(
            network,
            env.scenario,
            make_expert(config, env.scenario),
            config.demonstrations,
            config.seed,
        )
    return NAF(config, env, network, device=device, acting_device=acting_device)


def make_expert(config: TrainingConfig, scenario: Scenario) -> Expert:
    """The policy without learning that demonstrates."""
    try:
        return EXPERTS[config.demonstrations.policy](scenario)
    except ScenarioError as error:
        raise ConfigError(
            f"demonstrations.num_transitions = {config.demonstrations.num_transitions}: must be 0: "
            f"{error}"
        ) from None


def start_network(config: TrainingConfig, scenario: Scenario) -> NAFNetwork:
    """The network as the training finds it: untrained, or that of the initial checkpoint."""
    form = config.network
    features = [feature.name for feature in CHANGER.seen(scenario)]
    check_networks(config, "network.hidden_sizes", form.hidden_sizes, len(features))
    try:
        make_encoder(form.encoder, features)
    except ValueError as error:
        raise ConfigError(f"network.encoder = {form.encoder!r}: {error}") from None
    try:
        network = make_network(
            scenario,
            form.mu,
            form.hidden_sizes,
            encoder=form.encoder,
            knows_action_cost=form.knows_action_cost,
            off_diagonal=form.off_diagonal,
        )
    except ValueError as error:
        raise ConfigError(f"network.mu = {form.mu!r}: {error}") from None
    path = config.initial_checkpoint
    # A run that is resumed has weights of its own.
    if path is None or config.resume is not None:
        return network
    try:
        initial = load_checkpoint(Path(path), scenario).network
    except CheckpointError as error:
        raise ConfigError(f"initial_checkpoint = {path!r}: {error}") from None
    for name, wanted, found in (
        ("mu", network.mu_name, initial.mu_name),
        ("encoder", network.encoder_name, initial.encoder_name),
        ("hidden_sizes", network.hidden_sizes, initial.hidden_sizes),
        ("knows_action_cost", network.has_action_costs, initial.has_action_costs),
        ("off_diagonal", network.off_diagonal, initial.off_diagonal),
    ):
        if found != wanted:
            raise ConfigError(
                f"network.{name} = {wanted!r}: must be {found!r}, that of initial_checkpoint = "
                f"{path!r}"
            )
    return initial
