"""Draw the ratings of one league or of several, such as those of other seeds.

python agents/adversary/ratings.py RUN/ratings.json [...] --figure FILE [--figure FILE]
"""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

from pydantic import Field

from marl_lanes.evaluation.figures import check_figure
from marl_lanes.evaluation.rating_figure import draw_ratings
from marl_lanes.scenario.fields import Count, Line, Real, Section
from marl_lanes.scenario.yaml_files import YamlError, read_yaml
from marl_lanes.terminal import lenient_streams
from marl_lanes.training.command_line import Parser, refusing
from marl_lanes.training.config import validate


class Player(Section):
    """A row of the file."""

    player: Line
    role: Literal["changer", "followers"]
    rating: Real
    low: Real | None
    high: Real | None
    success_rate: Real
    missed_rate: Real
    nobody_rate: Real
    generation: Count | None
    is_held_out: bool


class Ratings(Section):
    """The file."""

    num_maneuvers: Count
    seed: Count
    confidence: Real = Field(gt=0.0, lt=1.0)
    ratings: list[Player] = Field(min_length=1)


@lenient_streams()
def main(arguments: Sequence[str] | None = None) -> None:
    """Read, draw."""
    parser = Parser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("ratings", nargs="+", type=Path, help="files of leagues")
    parser.add_argument(
        "--figure", action="append", required=True, type=Path, help="in the format of its ending"
    )
    options = parser.parse_args(arguments)
    with refusing():
        for path in options.figure:
            check_figure(path)
        draw_ratings(options.figure, [read(path) for path in options.ratings])


def read(path: Path) -> dict[str, Any]:
    """What a league has written, checked.

    Raises:
        ValueError: it cannot be read, or is no such file.
    """
    try:
        content = read_yaml(path)
    except YamlError as error:
        raise ValueError(f"{path}: {error}") from None
    return validate(Ratings, content, f"{path}: ").model_dump()


if __name__ == "__main__":
    main()
