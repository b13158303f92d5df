"""One NAF update compared with the same arithmetic in bare PyTorch, in the same run.

python benchmarks/naf_update.py [--rounds N] [--eager] [--kernels] [--json FILE]

An update is what ``Learner.update`` does: draw a batch, loss, backward, fused Adam, soft target.
The bare one has plain tensors for the replay buffer and functions for the networks, and no library
except torch. Before the timing both make the same updates from the same start, and must end with
the same parameters. Then they take turns (A B A B ...); the table shows medians of CPU time.
A second table counts the kernels that an update would launch on a GPU: with the networks one by one
as on the CPU ("plain"), and together as on a GPU ("batched"); with --kernels it is all there is.
"""

import argparse
import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
from kernels import count_compiled_kernels, count_kernels, print_kernels
from tensordict import TensorDict
from torch import Tensor
from torch.nn.functional import mse_loss, softplus
from torch.optim.swa_utils import get_ema_multi_avg_fn

from marl_lanes import LaneChangeEnv, NAFNetwork, load_scenario
from marl_lanes.files import write_json
from marl_lanes.naf.lateral import A_MAX_FLOOR, PaperMu
from marl_lanes.naf.network import LOG_DIAGONAL_BOUND
from marl_lanes.training.algorithms.naf import NAF, NAFConfig
from marl_lanes.training.checkpoint import make_network
from marl_lanes.training.config import validate
from marl_lanes.training.learner import Learner
from marl_lanes.training.replay import Replay

TARGETS = {64: 1.3, 1024: 1.1}
"""Target: largest ratio of the time of an update to that of the bare one, both eager."""
CAPACITY = 65_536
GAMMA, TAU, RATE = 0.99, 0.02, 5e-4
COUNTED_BATCH = 1024
"""Rows of the updates whose kernels are counted."""
UPDATES_PER_TURN = {64: 128, 1024: 32}
CHECKED_UPDATES = 20
TOLERANCE = 2e-5
"""Largest allowed difference of the parameters after CHECKED_UPDATES."""


class BareUpdate:
    """The update on plain tensors: networks (paper mu, one action), replay, Adam, target.

    Args:
        network: where it starts; nothing of it is changed.
        replay: observation, action, next_observation, reward, terminated, each (N, ...).
        batch_size: rows an update.
        is_compiled: whether the loss goes through torch.compile.
    """

    def __init__(
        self,
        network: NAFNetwork,
        replay: Mapping[str, Tensor],
        batch_size: int,
        *,
        is_compiled: bool,
    ) -> None:
        self.replay = replay
        self.batch_size = batch_size
        self.offset, self.scale = network.normalise.offset, network.normalise.scale
        self.half_range = network.box.half_range
        mu = network.mu
        if not isinstance(mu, PaperMu):
            raise TypeError(f"the bare update has the mu 'paper', got {network.mu_name!r}")
        self.columns, self.bound, self.min_time = mu.columns, mu.bound, mu.min_time
        self.factor, self.value, self.mu = (
            [value.detach().clone().requires_grad_() for value in part.parameters()]
            for part in (network.factor_logits, network.value, mu)
        )
        self.parameters = [*self.factor, *self.value, *self.mu]
        self.data = [value.detach() for value in self.parameters]
        self.target = [value.clone() for value in self.data]
        self.update_target: Callable[..., None] = get_ema_multi_avg_fn(1.0 - TAU)  # type: ignore[no-untyped-call]
        self.target_value = self.target[len(self.factor) : len(self.factor) + len(self.value)]
        self.optimizer = torch.optim.Adam(self.parameters, lr=RATE, fused=True)
        self.loss: Callable[..., Tensor] = torch.compile(self._loss) if is_compiled else self._loss

    def update(self, number: int) -> list[float]:
        """Make ``number`` updates; returns their losses."""
        return torch.stack([self._take_step() for _ in range(number)]).tolist()

    def _take_step(self) -> Tensor:
        rows = torch.randint(CAPACITY, (self.batch_size,))
        batch = {key: value.index_select(0, rows) for key, value in self.replay.items()}
        self.optimizer.zero_grad()
        loss = self.loss(**batch)
        loss.backward()  # type: ignore[no-untyped-call]
        self.optimizer.step()
        self.update_target(self.target, self.data, None)
        return loss.detach()

    def _loss(
        self,
        observation: Tensor,
        action: Tensor,
        next_observation: Tensor,
        reward: Tensor,
        terminated: Tensor,
    ) -> Tensor:
        normalised = (observation - self.offset) / self.scale
        limit, beta, time = _batched(normalised, self.mu).unbind(0)
        speed, deviation, yaw = (observation[:, c : c + 1] for c in self.columns)
        beta, time = softplus(beta), self.min_time + softplus(time)
        demand = (deviation / time - speed * yaw) / time
        limit = self.bound * (A_MAX_FLOOR + (1 - A_MAX_FLOOR) * torch.sigmoid(limit))
        mu = limit * torch.tanh(beta * demand)
        logit = _single(normalised, self.factor)
        factor = torch.exp(LOG_DIAGONAL_BOUND * torch.tanh(logit / LOG_DIAGONAL_BOUND))
        distance = (mu - action) / self.half_range
        q = _single(normalised, self.value) - (factor * distance).square()
        with torch.no_grad():
            following = (next_observation - self.offset) / self.scale
            value = _single(following, self.target_value)
            target = reward + GAMMA * ~terminated * value
        return mse_loss(q, target)


def _single(rows: Tensor, layers: Sequence[Tensor]) -> Tensor:
    hidden = torch.tanh(torch.addmm(layers[1], rows, layers[0]))
    hidden = torch.tanh(torch.addmm(layers[3], hidden, layers[2]))
    return torch.addmm(layers[5], hidden, layers[4])


def _batched(rows: Tensor, layers: Sequence[Tensor]) -> Tensor:
    hidden = rows.expand(layers[0].shape[0], -1, -1)
    hidden = torch.tanh(torch.baddbmm(layers[1], hidden, layers[0]))
    hidden = torch.tanh(torch.baddbmm(layers[3], hidden, layers[2]))
    return torch.baddbmm(layers[5], hidden, layers[4])


def make_transitions(network: NAFNetwork) -> dict[str, Tensor]:
    """Made-up transitions, in the features' units."""
    generator = torch.Generator().manual_seed(1)

    def draw(*shape: int) -> Tensor:
        return torch.randn(shape, generator=generator)

    normalise = network.normalise
    size = (CAPACITY, len(network.features))
    return {
        "observation": draw(*size) * normalise.scale + normalise.offset,
        "action": draw(CAPACITY, 1) * 0.1,
        "next_observation": draw(*size) * normalise.scale + normalise.offset,
        "reward": -draw(CAPACITY, 1).abs(),
        "terminated": draw(CAPACITY, 1) > 2.0,
    }


def make_learner(
    network: NAFNetwork,
    replay: Mapping[str, Tensor],
    batch_size: int,
    *,
    is_compiled: bool,
    is_batched: bool = False,
) -> Learner:
    """A learner with the transitions in its replay buffer; it does not collect any."""
    config = validate(
        NAFConfig,
        {
            "collector": {"num_envs": 1, "steps_per_batch": 1, "total_transitions": 1},
            "replay": {
                "capacity": CAPACITY,
                "storage": "memory",
                "batch_size": batch_size,
                "rare_share": 0.0,
                "warmup_transitions": 0,
            },
            "loss": {
                "gamma": GAMMA,
                "target_update": "soft",
                "num_steps": 1,
                "tau": TAU,
                "target_interval": 1,
            },
            "optimizer": {
                "learning_rate": RATE,
                "mu_learning_rate": RATE,
                "longitudinal_learning_rate": None,
                "final_rate": 1.0,
                "max_gradient_norm": None,
                "transitions_per_update": 1.0,
                "pretraining_transitions": 0,
                "compile": is_compiled,
            },
            "exploration": {
                "initial_sigma": 0.1,
                "final_sigma": 0.1,
                "annealing_transitions": 1,
                "probability": 1.0,
                "longitudinal_factor": 1.0,
            },
            "evaluation": {
                "save_interval": 1,
                "num_maneuvers": 1,
                "final_num_maneuvers": 1,
                "seed": 0,
                "criterion": None,
                "record": False,
            },
        },
    )
    env = LaneChangeEnv("paper", seed=0)
    learner = Learner(config, env, NAF(config, env, network, is_batched=is_batched))
    # A training makes it when it begins, in its run folder; one in memory needs none.
    learner.experience = Replay(config.replay, Path("unused"), 0, transitions_per_update=1.0)
    is_end = replay["terminated"]
    ends = {"done": is_end, "terminated": is_end, "truncated": torch.zeros_like(is_end)}
    following = {"observation": replay["next_observation"], "reward": replay["reward"], **ends}
    rows = {key: replay[key] for key in ("observation", "action")}
    size = [CAPACITY]
    learner.experience.extend(TensorDict({**rows, "next": TensorDict(following, size)}, size))
    return learner


def check_same(learner: Learner, network: NAFNetwork, bare: BareUpdate) -> float:
    """Largest difference of any parameter or target after the same updates from the same start.

    Raises:
        AssertionError: it is above TOLERANCE.
    """
    for contestant in (learner, bare):
        torch.manual_seed(7)
        contestant.update(CHECKED_UPDATES)
    targets = learner.algorithm.loss.target_value_network_params
    with targets.to_module(network):
        ours = _all_parameters(network)
    pairs = zip([*_all_parameters(network), *ours], [*bare.parameters, *bare.target], strict=True)
    difference = max(float((one - other).detach().abs().max()) for one, other in pairs)
    if not difference <= TOLERANCE:
        raise AssertionError(f"parameters differ by {difference:.2g}: must be {TOLERANCE:g}")
    return difference


def _all_parameters(network: NAFNetwork) -> list[Tensor]:
    parts = (network.factor_logits, network.value, network.mu)
    return [value.detach().clone() for part in parts for value in part.parameters()]


def measure(batch_size: int, rounds: int, *, has_compiled: bool) -> dict[str, Any]:
    """Median CPU time per update of every contestant [us], and the ratios."""
    contestants: dict[str, Callable[[int], object]] = {}
    differences = {}
    for mode in ("eager", "compiled") if has_compiled else ("eager",):
        torch.manual_seed(0)
        network = make_network(load_scenario("paper"), "paper")
        replay = make_transitions(network)
        is_compiled = mode == "compiled"
        bare = BareUpdate(network, replay, batch_size, is_compiled=is_compiled)
        learner = make_learner(network, replay, batch_size, is_compiled=is_compiled)
        differences[mode] = check_same(learner, network, bare)
        contestants[f"bare {mode}"] = bare.update
        contestants[f"marl_lanes {mode}"] = learner.update
    number = UPDATES_PER_TURN[batch_size]
    times: dict[str, list[float]] = {name: [] for name in contestants}
    for _ in range(rounds + 1):
        for name, update in contestants.items():
            start = time.process_time()
            update(number)
            times[name].append((time.process_time() - start) / number * 1e6)
    # The first turn of each is a warm-up. A ratio is taken between turns of the same round.
    kept = {name: values[1:] for name, values in times.items()}
    base = kept["bare eager"]
    return {
        "batch_size": batch_size,
        "microseconds": {name: statistics.median(values) for name, values in kept.items()},
        "over_bare_eager": {
            name: statistics.median(a / b for a, b in zip(values, base, strict=True))
            for name, values in kept.items()
        },
        "target": TARGETS[batch_size],
        "largest_difference": differences,
    }


def count(*, has_compiled: bool) -> dict[str, dict[str, float]]:
    """Kernels of an update on a GPU by group, for every kind of update."""
    torch.manual_seed(0)
    network = make_network(load_scenario("paper"), "paper")
    replay = make_transitions(network)
    found: dict[str, dict[str, float]] = {}
    for name, is_batched in (("plain", False), ("batched", True)):
        options = {"is_batched": is_batched}
        learner = make_learner(network, replay, COUNTED_BATCH, is_compiled=False, **options)
        found[name] = count_kernels(learner)
        if has_compiled:
            learner = make_learner(network, replay, COUNTED_BATCH, is_compiled=True, **options)
            found[f"{name} compiled"] = {**found[name], **count_compiled_kernels(learner)}
    return found


def main() -> None:
    """Check, run the rounds, print the tables, write the JSON."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=21, help="turns of each (default: 21)")
    parser.add_argument("--eager", action="store_true", help="leave torch.compile out")
    parser.add_argument("--kernels", action="store_true", help="count kernels, and measure nothing")
    parser.add_argument("--json", type=Path, help="write the figures to this file as well")
    options = parser.parse_args()
    torch.set_num_threads(1)
    kernels = count(has_compiled=not options.eager)
    print_kernels(kernels)
    results = []
    if not options.kernels:
        results = [
            measure(batch_size, options.rounds, has_compiled=not options.eager)
            for batch_size in TARGETS
        ]
        print_times(results)
    if options.json is not None:
        write_json(options.json, {"kernels": kernels, "times": results})


def print_times(results: Sequence[Mapping[str, Any]]) -> None:
    """The table of the times, and how far the contestants are apart."""
    print(f"{'batch':>6} {'update':20} {'microseconds':>12} {'/ bare eager':>13} {'target':>8}")
    for result in results:
        for name, duration in result["microseconds"].items():
            target = f"<= {result['target']}" if name == "marl_lanes eager" else ""
            ratio = result["over_bare_eager"][name]
            batch = result["batch_size"]
            print(f"{batch:6} {name:20} {duration:12,.0f} {ratio:13.2f} {target:>8}")
    for result in results:
        for mode, difference in result["largest_difference"].items():
            print(
                f"batch {result['batch_size']}, {mode}: after {CHECKED_UPDATES} updates the "
                f"parameters of both differ by at most {difference:.1e}"
            )


if __name__ == "__main__":
    main()
