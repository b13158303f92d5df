"""Train the shared policy of all lane changers with another algorithm than NAF; evaluate, report.

python agents/baselines/train.py ALGORITHM [scenario=NAME] [seed=N] [output=DIR] [resume=RUN]
    [collector.kind=multi|ray num_workers=N [ray.address=HOST:PORT]] [any field of the config]

ALGORITHM is ippo, mappo, sac, td3 or ddpg. Its YAML file in this folder has its values; ALGORITHM
--help explains the fields.
"""

import argparse
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Literal, NamedTuple

import torch

from marl_lanes import LaneChangeEnv, Scenario
from marl_lanes.experiment import run, start
from marl_lanes.terminal import lenient_streams
from marl_lanes.traffic.roles.changer import CHANGER
from marl_lanes.training.algorithms.actor_critic import ActorNetwork
from marl_lanes.training.algorithms.algorithm import Algorithm
from marl_lanes.training.algorithms.ddpg import DDPG, DDPGConfig
from marl_lanes.training.algorithms.ppo import PPO, STATE_SCALES, PPOConfig
from marl_lanes.training.algorithms.sac import SAC, SACConfig
from marl_lanes.training.algorithms.td3 import TD3, TD3Config
from marl_lanes.training.checkpoint import make_actor_network
from marl_lanes.training.command_line import Parser, describe_command, read_command_line, refusing
from marl_lanes.training.config import (
    ChangersConfig,
    DistributedCollectorConfig,
    read_changers_config,
)
from marl_lanes.training.sizes import check_networks

FOLDER = Path(__file__).parent
PROGRAM = "python agents/baselines/train.py"


class IPPOTrainingConfig(PPOConfig, ChangersConfig):
    """Everything that defines a run with IPPO."""

    collector: DistributedCollectorConfig
    algorithm: Literal["ippo"]


class MAPPOTrainingConfig(PPOConfig, ChangersConfig):
    """Everything that defines a run with MAPPO."""

    collector: DistributedCollectorConfig
    algorithm: Literal["mappo"]


class SACTrainingConfig(SACConfig, ChangersConfig):
    """Everything that defines a run with SAC."""

    collector: DistributedCollectorConfig
    algorithm: Literal["sac"]


class TD3TrainingConfig(TD3Config, ChangersConfig):
    """Everything that defines a run with TD3."""

    collector: DistributedCollectorConfig
    algorithm: Literal["td3"]


class DDPGTrainingConfig(DDPGConfig, ChangersConfig):
    """Everything that defines a run with DDPG."""

    collector: DistributedCollectorConfig
    algorithm: Literal["ddpg"]


class Baseline(NamedTuple):
    """An algorithm and its configuration."""

    config: type[ChangersConfig]
    algorithm: Callable[..., Algorithm]
    has_state: bool = False
    """Whether it needs the road's state."""


BASELINES = {
    "ippo": Baseline(IPPOTrainingConfig, PPO),
    "mappo": Baseline(MAPPOTrainingConfig, partial(PPO, is_centralised=True), has_state=True),
    "sac": Baseline(SACTrainingConfig, SAC),
    "td3": Baseline(TD3TrainingConfig, TD3),
    "ddpg": Baseline(DDPGTrainingConfig, DDPG),
}


def make(
    config: Any,
    algorithm: Callable[..., Algorithm],
    env: LaneChangeEnv,
    scenario: Scenario,
    device: torch.device,
    acting_device: torch.device,
) -> Algorithm:
    """The algorithm with an untrained actor."""
    widths = config.network.hidden_sizes
    num_inputs = len(CHANGER.seen(scenario))
    if env.has_state:
        num_inputs += env.scenario.max_vehicles * len(STATE_SCALES)
    check_networks(config, "network.hidden_sizes", widths, num_inputs)
    network: ActorNetwork = make_actor_network(scenario, widths)
    return algorithm(config, env, network, device=device, acting_device=acting_device)


@lenient_streams()
def main(arguments: Sequence[str] | None = None) -> None:
    """Train, evaluate, report."""
    parser = Parser(
        description=__doc__,
        usage="%(prog)s ALGORITHM [FIELD=VALUE ...] [--cfg job]",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("algorithm", choices=list(BASELINES))
    parser.add_argument("overrides", nargs=argparse.REMAINDER, metavar="FIELD=VALUE")
    options = parser.parse_args(arguments)
    baseline = BASELINES[options.algorithm]
    with refusing():
        config = read(options.algorithm, options.overrides)
        command = describe_command(PROGRAM, arguments)
        make_algorithm = partial(make, config, baseline.algorithm)
        learner, scenario = start(config, make_algorithm, command, has_state=baseline.has_state)
    run(learner, config, scenario)


def read(algorithm: str, overrides: Sequence[str]) -> ChangersConfig:
    """The configuration of the command line and the YAML files."""
    kind = BASELINES[algorithm].config
    fields = read_command_line(kind, FOLDER, str(__doc__), overrides, file=algorithm)
    return read_changers_config(kind, fields)


if __name__ == "__main__":
    main()
