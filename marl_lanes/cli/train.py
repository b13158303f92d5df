"""The command that trains the shared policy of all lane changers."""

from argparse import Namespace

from marl_lanes.cli.arguments import Commands
from marl_lanes.cli.completers import offer, overrides
from marl_lanes.extras import need

PROGRAM = "marl-lanes train"


def add(commands: Commands) -> None:
    """Add ``train``."""
    # It has a help of its own: here nothing is an option, and all goes on to the training.
    train = commands.add_parser(
        "train",
        help="train the shared policy with NAF, evaluate it, report",
        add_help=False,
        prefix_chars="\0",
    )
    offer(train.add_argument("overrides", nargs="*", metavar="FIELD=VALUE"), overrides)
    train.set_defaults(run=_train)


def _train(options: Namespace) -> None:
    for package in ("hydra", "matplotlib", "tensorboard", "tqdm"):
        need(package, "train")

    from marl_lanes.recipes.naf import train

    train(PROGRAM, options.overrides)
