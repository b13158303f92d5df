"""Train the shared NAF policy of all lane changers: ``marl-lanes train`` as a program."""

from collections.abc import Sequence

from marl_lanes.recipes.naf import train


def main(arguments: Sequence[str] | None = None) -> None:
    """Train, evaluate, report."""
    train("python agents/naf/train.py", arguments)


if __name__ == "__main__":
    main()
