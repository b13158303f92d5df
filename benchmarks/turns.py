"""Contestants that take turns, the medians of their figures, and the output of these."""

import argparse
import statistics
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple


class Rate(NamedTuple):
    """The work of a contestant, in total or per second."""

    steps: float
    """Steps of environments, as users count them."""
    vehicle_steps: float
    """Vehicles on the road times time steps."""


Contestant = Callable[[], Rate]
"""Advances for some milliseconds and returns the work done."""


def run_for(contestant: Contestant, seconds: float) -> Rate:
    """Let it run for about ``seconds``; per second."""
    steps = vehicle_steps = 0.0
    start = time.perf_counter()
    while (elapsed := time.perf_counter() - start) < seconds:
        done = contestant()
        steps += done.steps
        vehicle_steps += done.vehicle_steps
    return Rate(steps / elapsed, vehicle_steps / elapsed)


def take_turns(
    contestants: Mapping[str, Contestant], rounds: int, seconds: float
) -> dict[str, list[Rate]]:
    """A B C A B C ..., after one uncounted turn of each."""
    for contestant in contestants.values():
        run_for(contestant, seconds)
    rates: dict[str, list[Rate]] = {name: [] for name in contestants}
    for _ in range(rounds):
        for name, contestant in contestants.items():
            rates[name].append(run_for(contestant, seconds))
    return rates


def median(rates: list[Rate]) -> Rate:
    """The median of each figure."""
    return Rate(*(statistics.median(column) for column in zip(*rates, strict=True)))


def median_ratio(ours: list[Rate], theirs: list[Rate], figure: str) -> float:
    """Median of the ratios ours/theirs of the rounds: drift of the machine cancels in a round."""
    pairs = zip(ours, theirs, strict=True)
    column = Rate._fields.index(figure)
    return statistics.median(a[column] / b[column] for a, b in pairs)


def read_options(doc: str, rounds: int) -> argparse.Namespace:
    """The options that every benchmark has."""
    parser = argparse.ArgumentParser(description=doc.splitlines()[0])
    parser.add_argument(
        "--rounds", type=int, default=rounds, help="turns of each (default: %(default)s)"
    )
    parser.add_argument("--json", type=Path, help="write the figures to this file as well")
    return parser.parse_args()


def print_target(what: str, value: float, bound: float, *, is_least: bool = True) -> bool:
    """Print one line: the figure, its target, and whether it holds."""
    holds = value >= bound if is_least else value <= bound
    sign = ">=" if is_least else "<="
    print(f"{what:58} {value:10.2f}  target {sign} {bound:g}: {'holds' if holds else 'MISSED'}")
    return holds
