"""Recover the reward's weights from lane changes that a policy, or the optimum, demonstrates.

python agents/irl/recover.py [--policy optimum|NAME|CHECKPOINT] [--scenario paper] [--maneuvers 40]
    [--candidates 10] [--rounds 4] [--samples 200] [--seed 0] --output irl.json
"""

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from marl_lanes.cli.policies import UNTRAINED, make_policy
from marl_lanes.evaluation.optimum import MINIMISED, find_unminimised
from marl_lanes.evaluation.preferences import (
    WEIGHTS,
    Demonstration,
    bootstrap_weights,
    find_cone,
    find_demonstrations,
    learn_weights,
    optimise,
)
from marl_lanes.evaluation.rollout import run_maneuvers
from marl_lanes.files import write_json
from marl_lanes.scenario import Scenario, load_scenario
from marl_lanes.scenario.messages import shown
from marl_lanes.terminal import lenient_streams
from marl_lanes.training.command_line import Parser, refusing

OPTIMUM = "optimum"
DRIVER = "tuned-cascade"
"""The policy whose starts and speeds the optimum has."""
COUNTS = {"maneuvers": 10**6, "candidates": 10**4, "rounds": 100, "samples": 10**5}


@lenient_streams()
def main(arguments: Sequence[str] | None = None) -> None:
    """Demonstrate, learn, print, write."""
    options = parse(arguments)
    with refusing():
        scenario = load_scenario(options.scenario)
        result = recover(options, scenario)
        write_json(options.output, {"scenario": scenario.name, **vars_of(options), **result})
    for name, value in result.items():
        print(f"{name}: {value}")


def recover(options: argparse.Namespace, scenario: Scenario) -> dict[str, Any]:
    """The ratios of the weights, how sure they are, and the true ones."""
    truth = np.array([getattr(scenario.reward, name) for name in WEIGHTS])
    unminimised = find_unminimised(scenario)
    if truth[0] == 0.0 or unminimised:
        raise ValueError(
            f"scenario {scenario.name!r}: its reward must charge {MINIMISED[0]}, and no steering "
            f"cost besides {', '.join(MINIMISED)}"
        )
    demonstrations, success = demonstrate(options, scenario)
    features = np.array([one.features for one in demonstrations])
    with tqdm(total=len(demonstrations) * options.rounds, desc="demonstrations") as bar:
        weights, candidates = learn_weights(
            scenario,
            demonstrations,
            num_candidates=options.candidates,
            num_rounds=options.rounds,
            seed=options.seed,
            progress=bar.update,
        )
    interval = bootstrap_weights(features, candidates, options.samples, options.seed)
    cone = find_cone(scenario, demonstrations, candidates)
    cheapest = np.array([optimise(scenario, one, truth) for one in demonstrations])
    return {
        "num_demonstrations": len(demonstrations),
        "completion_rate": success,
        "cost_ratio": float((features @ truth).sum() / (cheapest @ truth).sum()),
        "true": by_name(truth / truth[0]),
        "learned": by_name(weights),
        "interval": by_name(interval.T),
        "cone": None if cone is None else by_name(cone.T),
    }


def demonstrate(
    options: argparse.Namespace, scenario: Scenario
) -> tuple[list[Demonstration], float]:
    """The demonstrations, and the share of the driver's commands that were completed."""
    is_optimum = options.policy == OPTIMUM
    policy = make_policy(DRIVER if is_optimum else options.policy, scenario, options.seed)
    maneuvers = run_maneuvers(scenario, policy, options.maneuvers, seed=options.seed)
    found = find_demonstrations(maneuvers, scenario)
    if not found:
        raise ValueError(
            f"--policy {shown(options.policy)}: must complete a lane change without an abort; none "
            f"of {len(maneuvers)} did"
        )
    if is_optimum:
        truth = np.array([getattr(scenario.reward, name) for name in WEIGHTS])
        found = [replace(one, features=optimise(scenario, one, truth)) for one in found]
    return found, sum(one.aftermath is not None for one in maneuvers) / len(maneuvers)


def by_name(values: NDArray[np.float64]) -> dict[str, Any]:
    """The ratios of the two weights that are not the unit."""
    return dict(zip(WEIGHTS[1:], values[1:].tolist(), strict=True))


def parse(arguments: Sequence[str] | None = None) -> argparse.Namespace:
    """The command line."""
    parser = Parser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument(
        "--policy",
        default=OPTIMUM,
        help=f"{OPTIMUM}, {', '.join(UNTRAINED)}, or a checkpoint (default: {OPTIMUM})",
    )
    parser.add_argument("--scenario", default="paper", help="name or YAML file (default: paper)")
    parser.add_argument("--maneuvers", type=int, default=40, help="to be driven (default: 40)")
    parser.add_argument(
        "--candidates", type=int, default=10, help="per demonstration and round (default: 10)"
    )
    parser.add_argument("--rounds", type=int, default=4, help="of candidates (default: 4)")
    parser.add_argument(
        "--samples", type=int, default=200, help="of the bootstrap interval (default: 200)"
    )
    parser.add_argument("--seed", type=int, default=0, help="default: 0")
    parser.add_argument("--output", type=Path, required=True, help="JSON file to write")
    options = parser.parse_args(arguments)
    for name, most in COUNTS.items():
        if not 1 <= getattr(options, name) <= most:
            value = shown(getattr(options, name))
            parser.error(f"--{name} {value}: must be at least 1, at most {most}")
    if not 0 <= options.seed < 2**62:
        parser.error(f"--seed {shown(options.seed)}: must be at least 0 and below 2^62")
    if options.output.is_dir() or any(above.is_file() for above in options.output.parents):
        parser.error(f"--output {shown(str(options.output))}: must be a file in a folder")
    return options


def vars_of(options: argparse.Namespace) -> dict[str, object]:
    """The options that define the result."""
    return {name: getattr(options, name) for name in ("policy", *COUNTS, "seed")}


if __name__ == "__main__":
    main()
