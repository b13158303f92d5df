"""Tune the cascade's constants in the simulator by a cross-entropy search: no network, no gradient.

python agents/cascade/tune.py [--scenario paper] [--generations 30] [--population 64] [--seed 0]
    --output cascade.json
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from tqdm import trange

from marl_lanes import ScenarioError, Simulator
from marl_lanes.files import write_json
from marl_lanes.memory import check_memory
from marl_lanes.naf.lateral import TUNED_CASCADE, CascadeGains, steer_by_cascade
from marl_lanes.scenario import Scenario, load_scenario
from marl_lanes.scenario.messages import shown
from marl_lanes.terminal import lenient_streams
from marl_lanes.traffic.placement import bytes_of_road
from marl_lanes.traffic.roles.changer import CHANGER
from marl_lanes.training.command_line import Parser, refusing

LOWEST = CascadeGains(limit=0.2, time=0.8, lateral_limit=0.3, lag=0.08, damping=0.4, threshold=0.0)
HIGHEST = CascadeGains(limit=0.5, time=2.5, lateral_limit=1.0, lag=0.3, damping=1.4, threshold=0.06)
MAX_COUNT = 10**6
MAX_SECONDS = 86_400.0
ELITE_SHARE = 0.15
"""Share of a generation from which the next one is drawn."""
LEAST_SPREAD = 0.002
"""[1] Share of each range, added to the standard deviation so that the search continues."""
STEERING_FEATURES = ("speed", "lateral_deviation", "yaw", "yaw_rate", "curvature")


@lenient_streams()
def main(arguments: Sequence[str] | None = None) -> None:
    """Search, print, write."""
    options = parse(arguments)
    with refusing():
        scenario = load_scenario(options.scenario)
        roads = Roads(scenario, options.population, options.roads, options.seconds, options.seed)
        result = search(roads, options.generations, options.seed)
        write_json(options.output, {"scenario": scenario.name, **vars_of(options), **result})
    for name, value in result.items():
        print(f"{name}: {value}")


class Roads:
    """Busy roads with the same traffic for every candidate.

    Args:
        scenario: with one action, and with the features of the cascade.
        population: number of candidates P at a time.
        roads: number of roads per candidate.
        seconds: simulated time [s].
        seed: of the traffic.

    Raises:
        ScenarioError: it has two actions, or a feature is missing.
    """

    def __init__(
        self, scenario: Scenario, population: int, roads: int, seconds: float, seed: int
    ) -> None:
        features: list[str] = list(scenario.observation.features)
        missing = [name for name in STEERING_FEATURES if name not in features]
        num_actions = len(CHANGER.act(scenario))
        if missing or num_actions != 1:
            raise ScenarioError(
                f"scenario {scenario.name!r}: must have one action and the features "
                f"{list(STEERING_FEATURES)}; it has {num_actions} and {features}"
            )
        self.columns = [features.index(name) for name in STEERING_FEATURES]
        self.population, self.roads = population, roads
        self.seconds, self.num_steps = seconds, round(seconds / scenario.time_step)
        self.seed = seed
        check_memory("--population", population, bytes_of_road(scenario) * population * roads)
        self.simulator = Simulator(
            scenario,
            population * roads,
            overrides={"num_agents": None, "horizon": None, "command": {"probability": 1.0}},
            seed=seed,
        )

    def drive(self, gains: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Mean cost per command (inf without one), and number of commands, of (P, 6) gains."""
        simulator = self.simulator
        simulator.seed(self.seed)
        # Road k has the same traffic for every candidate.
        roads = simulator.state.roads
        roads["random_stream"] = np.tile(np.arange(self.roads), self.population)
        simulator.reset()
        costs, counts = np.zeros(self.population), np.zeros(self.population, np.int64)
        actions = np.zeros_like(simulator.actions)
        for _ in range(self.num_steps):
            acting = simulator.is_acting
            owners = np.nonzero(acting)[0] // self.roads
            seen = simulator.state.observations[acting][:, self.columns].astype(np.float64)
            actions.fill(0.0)
            actions[acting, 0] = self.steer(seen, gains[owners])
            simulator.step(actions)
            ended = simulator.has_ended
            owners = np.nonzero(ended)[0] // self.roads
            np.add.at(costs, owners, -simulator.agents["episode_reward"][ended])
            np.add.at(counts, owners, 1)
        # A candidate without a finished command must not be the cheapest.
        return np.where(counts > 0, costs / np.maximum(counts, 1), np.inf), counts

    @staticmethod
    def steer(seen: NDArray[np.float64], gains: NDArray[np.float64]) -> NDArray[np.float64]:
        """Yaw accelerations (N,) of observations (N, 5) with gains (N, 6)."""
        speed, deviation, yaw, yaw_rate, curvature = torch.from_numpy(seen).unbind(-1)
        each = CascadeGains(*torch.from_numpy(gains).unbind(-1))
        steering, _ = steer_by_cascade(speed, deviation, yaw, yaw_rate - curvature * speed, each)
        return np.asarray(steering.numpy())


def search(roads: Roads, generations: int, seed: int) -> dict[str, object]:
    """The best mean of a generation's elite; the search starts around the present constants."""
    generator = np.random.default_rng(seed)
    low, high = np.array(LOWEST), np.array(HIGHEST)
    mean, spread = np.array(TUNED_CASCADE), (high - low) / 8.0
    num_elite = max(2, round(ELITE_SHARE * roads.population))
    start = cost = best = np.inf
    chosen = mean
    for generation in trange(generations, desc="generations"):
        drawn = mean + spread * generator.standard_normal((roads.population, low.size))
        drawn[0] = mean
        drawn = np.clip(drawn, low, high)
        costs, _ = roads.drive(drawn)
        cost = float(costs[0])
        if cost == np.inf:
            raise ScenarioError(
                f"seconds = {roads.seconds:g}: must be longer; no command of scenario "
                f"{roads.simulator.scenario.name!r} ended on {roads.roads} roads"
            )
        start = cost if generation == 0 else start
        if cost < best:
            best, chosen = cost, drawn[0]
        elite = drawn[np.argsort(costs)[:num_elite]]
        mean, spread = elite.mean(0), elite.std(0) + LEAST_SPREAD * (high - low)
    names = CascadeGains._fields
    return {
        "cost_of_the_present_constants": start,
        "cost": best,
        "constants": dict(zip(names, chosen.round(4).tolist(), strict=True)),
    }


def parse(arguments: Sequence[str] | None = None) -> argparse.Namespace:
    """The command line."""
    parser = Parser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--scenario", default="paper", help="name or YAML file (default: paper)")
    parser.add_argument("--generations", type=int, default=30, help="default: 30")
    parser.add_argument("--population", type=int, default=64, help="candidates (default: 64)")
    parser.add_argument("--roads", type=int, default=16, help="per candidate (default: 16)")
    parser.add_argument(
        "--seconds", type=float, default=60.0, help="simulated time [s] (default: 60)"
    )
    parser.add_argument("--seed", type=int, default=0, help="default: 0")
    parser.add_argument("--output", type=Path, required=True, help="JSON file to write")
    options = parser.parse_args(arguments)
    for name in ("generations", "population", "roads"):
        if not 1 <= getattr(options, name) <= MAX_COUNT:
            value = shown(getattr(options, name))
            parser.error(f"--{name} {value}: must be at least 1, at most {MAX_COUNT}")
    if not 0.0 < options.seconds <= MAX_SECONDS:
        parser.error(f"--seconds {options.seconds}: must be above 0 and at most {MAX_SECONDS:g}")
    if not 0 <= options.seed < 2**63:
        parser.error(f"--seed {shown(options.seed)}: must be at least 0 and below 2^63")
    if options.output.is_dir() or any(above.is_file() for above in options.output.parents):
        parser.error(f"--output {shown(str(options.output))}: must be a file in a folder")
    return options


def vars_of(options: argparse.Namespace) -> dict[str, object]:
    """The options that define the search."""
    names = ("generations", "population", "roads", "seconds", "seed")
    return {name: getattr(options, name) for name in names}


if __name__ == "__main__":
    main()
