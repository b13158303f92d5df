"""Train the shared policy of all lane changers with another algorithm than NAF; evaluate, report.

python agents/baselines/train.py ALGORITHM [scenario=NAME] [seed=N] [output=DIR] [resume=RUN]
    [collector.kind=multi|ray num_workers=N [ray.address=HOST:PORT]] [any field of the config]

ALGORITHM is td3. Its YAML file in this folder has its values; ALGORITHM --help explains the fields.
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
from marl_lanes.training.algorithms.algorithm import Algorithm
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
PROGRAM = "agents/baselines/train.py"


class TD3TrainingConfig(TD3Config, ChangersConfig):
    """Everything that defines a run with TD3."""

    collector: DistributedCollectorConfig
    algorithm: Literal["td3"]


def make_td3(
    config: TD3TrainingConfig,
    env: LaneChangeEnv,
    scenario: Scenario,
    device: torch.device,
    acting_device: torch.device,
) -> TD3:
    """TD3 with an untrained actor."""
    widths = config.network.hidden_sizes
    check_networks(config, "network.hidden_sizes", widths, len(CHANGER.seen(scenario)))
    network = make_actor_network(scenario, widths)
    return TD3(config, env, network, device=device, acting_device=acting_device)


class Baseline(NamedTuple):
    """An algorithm's configuration, and the function that makes the algorithm."""

    config: type[ChangersConfig]
    make: Callable[[Any, LaneChangeEnv, Scenario, torch.device, torch.device], Algorithm]


BASELINES = {"td3": Baseline(TD3TrainingConfig, make_td3)}


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
        learner, scenario = start(config, partial(baseline.make, config), command)
    run(learner, config, scenario)


def read(algorithm: str, overrides: Sequence[str]) -> ChangersConfig:
    """The configuration of the command line and the YAML files."""
    kind = BASELINES[algorithm].config
    fields = read_command_line(kind, FOLDER, str(__doc__), overrides, file=algorithm)
    return read_changers_config(kind, fields)


if __name__ == "__main__":
    main()
