"""Does memory recognise an adversary? Classifiers of a follower's disposition, apart from control.

python agents/memory/recognise.py [--scenario hidden] [--policy cascade-prior] [--roads 128]
    [--seconds 300] [--updates 3000] [--seed 0] --output recognition.json [--figure FILE]

A policy without memory drives. What every lane changer sees in the first seconds after it has
engaged is recorded, with the disposition of the driver behind it, which it does not see. On most
roads classifiers learn the disposition from one observation, from several stacked ones and from a
GRU over these; the other roads tell how often they are right, and when.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from matplotlib.figure import Figure
from numpy.typing import NDArray
from torch import Tensor, nn
from torchrl.modules import MLP
from tqdm import trange

from marl_lanes import Simulator
from marl_lanes.cli.policies import make_policy
from marl_lanes.evaluation.driving import Policy, drive
from marl_lanes.evaluation.figures import check_figure
from marl_lanes.evaluation.intervals import estimate_mean
from marl_lanes.evaluation.style import GREY, WIDTH, styled, write_figure
from marl_lanes.files import write_json
from marl_lanes.memory import check_memory
from marl_lanes.naf.encoder import make_encoder
from marl_lanes.naf.network import Normaliser
from marl_lanes.scenario import Scenario, ScenarioError, load_scenario
from marl_lanes.scenario.dispositions import SCRIPTED
from marl_lanes.scenario.messages import shown
from marl_lanes.terminal import lenient_streams
from marl_lanes.traffic.machine.state import NONE, Disposition, Phase
from marl_lanes.traffic.roles.changer import CHANGER
from marl_lanes.training.command_line import Parser, refusing
from marl_lanes.training.torch_settings import training_settings


class Memory(NamedTuple):
    """What a classifier sees."""

    num_stacked: int
    encoder: str


MEMORIES = {
    "1 observation": Memory(1, "none"),
    "4 stacked": Memory(4, "none"),
    "8 stacked": Memory(8, "none"),
    "16 stacked": Memory(16, "none"),
    "GRU over 16": Memory(16, "gru"),
}
MOST_STACKED = 16
MAX_TIME = 3.0
"""[s] Since the engagement; most bodies are in the target lane by then."""
TRAINING_SHARE = 0.75
"""Of the roads; the others are for the test."""
HIDDEN_SIZES = (64, 64)
BATCH_SIZE = 512
LEARNING_RATE = 2e-3
NUM_RESAMPLES = 2000
"""Of the test's roads, for an interval of 95 %."""
ENGAGED_SHARE = 0.5
"""Of the roads in a time step, at most about, for the estimate of memory."""
TOLD_TIMES = (0.0, 0.2, 0.4, 0.6, 1.0, 2.0, 3.0)
"""[s] In the printed table."""
MAX_COUNT = 10**6


@lenient_streams()
def main(arguments: Sequence[str] | None = None) -> None:
    """Drive, learn, test, write, print."""
    options = parse(arguments)
    with refusing(), training_settings(torch.device("cpu")):
        torch.set_num_threads(1)
        plain = load_scenario(options.scenario, {"observation": {"num_stacked": 1}})
        policy = make_policy(options.policy, plain, options.seed)
        rows = watch(plain, policy, options.roads, options.seconds, options.seed)
        for path in options.figure:
            check_figure(path)
        is_test = rows.road >= round(TRAINING_SHARE * options.roads)
        check_rows(rows, is_test, plain)
        torch.manual_seed(options.seed)
        found = {
            name: judge(rows, is_test, learn(memory, plain, rows, ~is_test, options.updates))
            for name, memory in MEMORIES.items()
        }
        told = {name: getattr(options, name) for name in ("roads", "seconds", "updates", "seed")}
        told |= {"scenario": plain.name, "policy": options.policy}
        told |= {"num_test_rows": int(is_test.sum()), "memories": found}
        write_json(options.output, told)
        if options.figure:
            draw(options.figure, found)
    print(table(found))


class Rows(NamedTuple):
    """What N agents saw in a step, each engaged for the first time since its command."""

    road: NDArray[np.int64]
    """(N,)"""
    time: NDArray[np.float64]
    """(N,) since the engagement [s]."""
    disposition: NDArray[np.int64]
    """(N,) of the driver behind."""
    seen: NDArray[np.float32]
    """(N, MOST_STACKED * F)"""


def watch(plain: Scenario, policy: Policy, num_roads: int, seconds: float, seed: int) -> Rows:
    """Drive, and record the engaged agents as long as the driver behind them is the same.

    Raises:
        ScenarioError: a follower of the mix is not scripted.
        ValueError: more memory is needed than there is.
    """
    if not set(plain.followers.mix) <= set(SCRIPTED):
        raise ScenarioError(
            f"scenario {plain.name!r}: followers.mix = {shown(dict(plain.followers.mix))}: must "
            f"name {', '.join(SCRIPTED)} alone"
        )
    endless = {"num_agents": None, "horizon": None, "observation": {"num_stacked": MOST_STACKED}}
    num_features, num_steps = len(CHANGER.seen(plain)), round(seconds / plain.time_step)
    size = 4.0 * MOST_STACKED * num_features
    check_memory("--seconds", seconds, 2.0 * ENGAGED_SHARE * num_roads * num_steps * size)
    simulator = Simulator(plain, num_roads, seed=seed, num_threads=1, overrides=endless)
    simulator.reset()
    driving = drive(simulator, lambda seen: policy(np.ascontiguousarray(seen[:, :num_features])))
    since = np.zeros(simulator.agents.shape, np.int64)
    behind = np.full(simulator.agents.shape, NONE)
    rows = []
    for _ in trange(num_steps, desc="driving", unit="step"):
        next(driving)
        now = followers_of(simulator)
        is_new = behind == NONE
        since = np.where(is_new, 0, since + 1)
        behind = np.where(is_new, now, behind)
        times = since * plain.time_step
        # A driver that comes later has not had the same time to react.
        chosen = (now != NONE) & (now == behind) & (times <= MAX_TIME + 1e-9)
        behind[simulator.agents["phase"] != Phase.ENGAGED] = NONE
        roads, slots = np.nonzero(chosen)
        drivers = simulator.agents["target_follower"][roads, slots]
        dispositions = simulator.vehicles["disposition"][roads, drivers]
        seen = simulator.state.observations[roads, slots]
        rows.append((roads, times[chosen], dispositions.astype(np.int64), seen))
    return Rows(*map(np.concatenate, zip(*rows, strict=True)))


def followers_of(simulator: Simulator) -> NDArray[np.int64]:
    """(E, A) serial number of the driver that reacts to an agent's first engagement, or NONE."""
    agents = simulator.agents
    slots = agents["target_follower"]
    drivers = np.take_along_axis(simulator.vehicles, np.maximum(slots, 0), axis=1)
    is_behind = (slots > NONE) & (drivers["changer"] == agents["vehicle"])
    is_first = (agents["phase"] == Phase.ENGAGED) & (agents["num_aborts"] == 0)
    return np.where(is_behind & is_first, drivers["id"], NONE)


def check_rows(rows: Rows, is_test: NDArray[np.bool_], scenario: Scenario) -> None:
    """Refuse rows from which nothing can be learned or told."""
    for part in (is_test, ~is_test):
        kinds = set(rows.disposition[part].tolist())
        if int(Disposition.ADVERSARIAL) not in kinds or len(kinds) < 2:
            raise ScenarioError(
                f"scenario {scenario.name!r}: must have adversarial and other followers behind "
                "engaged changers, on the roads of the training and of the test: set "
                "followers.mix, more --roads or --seconds"
            )


def learn(
    memory: Memory, plain: Scenario, rows: Rows, is_used: NDArray[np.bool_], num_updates: int
) -> NDArray[np.float64]:
    """Probabilities of the dispositions for all rows, (N, 3), by a classifier of the used ones."""
    scenario = load_scenario(plain, {"observation": {"num_stacked": memory.num_stacked}})
    columns = CHANGER.seen(scenario)
    names = [column.name for column in columns]
    encoder = make_encoder(memory.encoder, names)
    normalise = Normaliser(names, [one.offset for one in columns], [one.scale for one in columns])
    network = nn.Sequential(
        normalise,
        encoder,
        MLP(len(encoder.outputs), len(SCRIPTED), num_cells=HIDDEN_SIZES, activation_class=nn.Tanh),
    )
    seen = torch.from_numpy(rows.seen)[:, : len(names)]
    labels = torch.from_numpy(rows.disposition)
    used = torch.from_numpy(np.nonzero(is_used)[0])
    optimizer = torch.optim.Adam(network.parameters(), lr=LEARNING_RATE)
    schedule = torch.optim.lr_scheduler.LinearLR(optimizer, 1.0, 0.01, num_updates)
    for _ in trange(num_updates, desc=f"{memory.encoder} {memory.num_stacked}", unit="update"):
        batch = used[torch.randint(len(used), (BATCH_SIZE,))]
        loss = nn.functional.cross_entropy(network(seen[batch]), labels[batch])
        optimizer.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        optimizer.step()
        schedule.step()
    with torch.inference_mode():
        found: Tensor = network(seen).softmax(-1)
    return np.asarray(found.numpy(), np.float64)


def judge(
    rows: Rows, is_test: NDArray[np.bool_], probabilities: NDArray[np.float64]
) -> dict[str, list[Any]]:
    """Accuracy, and the area under the curve of the adversarial ones, at every time."""
    result: dict[str, list[Any]] = {"time": [], "num_rows": [], "auc": [], "accuracy": []}
    score, kind = probabilities[:, Disposition.ADVERSARIAL], int(Disposition.ADVERSARIAL)
    is_right = probabilities.argmax(1) == rows.disposition
    for time in np.unique(rows.time[is_test]):
        chosen = is_test & (rows.time == time)
        roads = rows.road[chosen]
        result["time"].append(round(float(time), 6))
        result["num_rows"].append(int(chosen.sum()))
        result["auc"].append(area(score[chosen], rows.disposition[chosen] == kind, roads))
        accuracy = estimate_mean(is_right[chosen], roads, is_rate=True)
        result["accuracy"].append(vars(accuracy))
    return result


def area(
    score: NDArray[np.float64], is_positive: NDArray[np.bool_], roads: NDArray[np.int64]
) -> dict[str, float | None]:
    """Share of the pairs (positive, negative) in which the positive has the higher score.

    With a bootstrap interval of 95 % over whole roads; None where there is no pair.
    """
    _, road = np.unique(roads, return_inverse=True)
    above, below = score[is_positive][:, None], score[~is_positive][None]
    if not above.size or not below.size:
        return {"value": None, "low": None, "high": None}
    wins = (above > below) + 0.5 * (above == below)
    # Pairs by the roads of both.
    num_roads = int(road.max()) + 1
    one = np.eye(num_roads)[road]
    won = one[is_positive].T @ wins @ one[~is_positive]
    all_pairs = np.outer(one[is_positive].sum(0), one[~is_positive].sum(0))
    drawn = np.random.default_rng(0).multinomial(
        num_roads, np.full(num_roads, 1.0 / num_roads), NUM_RESAMPLES
    )
    counts = np.einsum("ri,ij,rj->r", drawn, all_pairs, drawn, optimize=True)
    sums = np.einsum("ri,ij,rj->r", drawn, won, drawn, optimize=True)
    values = sums[counts > 0] / counts[counts > 0]
    low, high = np.quantile(values, [0.025, 0.975])
    return {"value": float(wins.mean()), "low": float(low), "high": float(high)}


def table(found: dict[str, dict[str, list[Any]]]) -> str:
    """The area under the curve of each memory at a few times."""
    lines = ["adversarial or not, area under the curve [95 % interval]"]
    lines.append("  ".join([f"{'seconds since the engagement':<28}", *map(str, found)]))
    for index, time in enumerate(next(iter(found.values()))["time"]):
        if time in TOLD_TIMES:
            cells = (one["auc"][index] for one in found.values())
            texts = [
                "-" if c["value"] is None else f"{c['value']:.3f} [{c['low']:.3f}, {c['high']:.3f}]"
                for c in cells
            ]
            lines.append("  ".join([f"{time:<28}", *texts]))
    return "\n".join(lines)


@styled
def draw(paths: Sequence[Path], found: dict[str, dict[str, list[Any]]]) -> None:
    """Draw the area under the curve over time, one line for each memory, with its interval."""
    figure = Figure(figsize=(WIDTH, 0.65 * WIDTH), layout="constrained")
    axes = figure.subplots()
    for name, one in found.items():
        value, low, high = (
            np.asarray([cell[key] for cell in one["auc"]], np.float64)
            for key in ("value", "low", "high")
        )
        (line,) = axes.plot(one["time"], value, label=name)
        axes.fill_between(one["time"], low, high, color=line.get_color(), alpha=0.15, lw=0.0)
    axes.axhline(0.5, color=GREY, ls="-", lw=0.6)
    axes.set_title("Is the driver behind an adversary?")
    axes.set_ylabel("area under the curve [1]; 0.5: a guess")
    axes.set_xlabel("time since the engagement [s]")
    axes.legend(loc="lower right")
    write_figure(figure, *paths)


def parse(arguments: Sequence[str] | None = None) -> argparse.Namespace:
    """The command line."""
    parser = Parser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter, usage=None
    )
    parser.add_argument("--scenario", default="hidden", help="name or YAML file (default: hidden)")
    parser.add_argument(
        "--policy", default="cascade-prior", help="name or checkpoint (default: cascade-prior)"
    )
    parser.add_argument("--roads", type=int, default=128, help="default: 128")
    parser.add_argument("--seconds", type=float, default=300.0, help="simulated (default: 300)")
    parser.add_argument("--updates", type=int, default=3000, help="of each (default: 3000)")
    parser.add_argument("--seed", type=int, default=0, help="default: 0")
    parser.add_argument("--output", type=Path, required=True, help="JSON file to write")
    parser.add_argument("--figure", type=Path, action="append", default=[], help="to draw")
    options = parser.parse_args(arguments)
    for name, least in (("roads", 4), ("updates", 1)):
        if not least <= getattr(options, name) <= MAX_COUNT:
            value = shown(getattr(options, name))
            parser.error(f"--{name} {value}: must be at least {least}, at most {MAX_COUNT}")
    if not 1.0 <= options.seconds <= MAX_COUNT:
        parser.error(f"--seconds {options.seconds}: must be at least 1 and at most {MAX_COUNT}")
    if not 0 <= options.seed < 2**63:
        parser.error(f"--seed {shown(options.seed)}: must be at least 0 and below 2^63")
    if options.output.is_dir() or any(above.is_file() for above in options.output.parents):
        parser.error(f"--output {shown(str(options.output))}: must be a file in a folder")
    return options


if __name__ == "__main__":
    main()
