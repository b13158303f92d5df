"""Pictures a second of ``render_mode="rgb_array"``: ours compared with highway-env's.

python benchmarks/rendering.py [--rounds N] [--json FILE]

The contestants take turns (A B C A B C ...); the table shows the medians of the rounds. A step and
a picture follow each other, as when a film is made. Both have about 40 vehicles on three lanes, one
of which at least is an agent. Ours shows 140 m of road to scale, the whole road as strips and a
panel; highway-env's shows the road around its vehicle at 5.5 pixels a metre.
"""

import statistics
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from peers import is_installed, open_highway_env
from turns import print_target, read_options

from marl_lanes import parallel_env
from marl_lanes.files import write_json

SECONDS = 1.0
"""[s] Length of a turn."""
TRAFFIC = {
    "departures": {"interval": [2.1, 4.2]},
    "command": {"probability": 1.0},
}
"""Of ``paper``: 40 vehicles on the road in the mean."""
NUM_VEHICLES = 40
SIZES = ((1280, 720), (600, 180))
THEIR_SIZE = (600, 150)
"""highway-env's default."""


class Contestant(NamedTuple):
    """An environment that renders."""

    step: Callable[[], None]
    render: Callable[[], Any]


class Rate(NamedTuple):
    """Pictures in a second of CPU time."""

    with_steps: float
    """A step before each picture."""
    alone: float
    """The time of the pictures only."""


def make_ours(size: tuple[int, int]) -> Contestant:
    """An ordinary user loop, with actions of zero."""
    env = parallel_env("paper", "rgb_array", overrides=TRAFFIC, view={"size": size}, seed=0)
    zero = np.zeros(1, np.float32)
    env.reset(seed=0)

    def step() -> None:
        if not env.agents:
            env.reset()
        env.step(dict.fromkeys(env.agents, zero))

    return Contestant(step, env.render)


def make_theirs(size: tuple[int, int]) -> Contestant:
    """highway-v0, a continuous action of zero, 10 Hz."""
    width, height = size
    env = open_highway_env(
        NUM_VEHICLES, "rgb_array", {"screen_width": width, "screen_height": height}
    )
    env.reset(seed=0)
    zero = np.zeros(2, np.float32)

    def step() -> None:
        _, _, terminated, truncated, _ = env.step(zero)
        if terminated or truncated:
            env.reset()

    return Contestant(step, env.render)


def run_for(contestant: Contestant, seconds: float) -> Rate:
    """Let it run for about ``seconds`` of CPU time, which other processes disturb the least."""
    count, rendering = 0, 0.0
    start = time.process_time()
    while (elapsed := time.process_time() - start) < seconds:
        contestant.step()
        before = time.process_time()
        contestant.render()
        rendering += time.process_time() - before
        count += 1
    return Rate(count / elapsed, count / rendering)


def main() -> None:
    """Run the rounds, print the table, write the JSON."""
    options = read_options(__doc__ or "", rounds=5)
    contestants = {("parallel_env", size): make_ours(size) for size in SIZES}
    if is_installed("highway_env"):
        for size in (*SIZES, THEIR_SIZE):
            contestants["highway-env", size] = make_theirs(size)
    for (name, size), contestant in contestants.items():
        wanted = (size[1], size[0], 3)
        if contestant.render().shape != wanted:
            raise SystemExit(f"{name}: its pictures are not {wanted}")
        run_for(contestant, SECONDS)
    rates: dict[tuple[str, tuple[int, int]], list[Rate]] = {key: [] for key in contestants}
    for _ in range(options.rounds):
        for key, contestant in contestants.items():
            rates[key].append(run_for(contestant, SECONDS))
    figures: dict[str, object] = {"rounds": options.rounds}
    print(f"{NUM_VEHICLES} vehicles; {options.rounds} rounds; pictures in a second of CPU time")
    print(f"{'':14} {'size':>10} {'with steps':>11} {'alone':>8}")
    for (name, size), rows in rates.items():
        row = Rate(*(statistics.median(column) for column in zip(*rows, strict=True)))
        form = f"{size[0]}x{size[1]}"
        print(f"{name:14} {form:>10} {row.with_steps:11.1f} {row.alone:8.1f}")
        figures[f"{name} {form}"] = row._asdict()
    ours = rates["parallel_env", SIZES[0]]
    value = statistics.median(rate.with_steps for rate in ours)
    print_target("pictures a second with steps of parallel_env, 1280x720", value, 60.0)
    theirs = rates.get(("highway-env", SIZES[0]), [])
    for figure in Rate._fields if theirs else ():
        pairs = zip(ours, theirs, strict=True)
        value = statistics.median(getattr(a, figure) / getattr(b, figure) for a, b in pairs)
        print_target(f"the same, {figure}, over highway-env", value, 1.0)
        figures[f"ratio {figure}"] = {"value": value, "target": 1.0}
    if options.json is not None:
        write_json(options.json, figures)


if __name__ == "__main__":
    main()
