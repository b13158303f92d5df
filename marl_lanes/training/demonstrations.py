"""Demonstrations of an expert, and mu fitted to its actions before a training begins.

The expert drives with noise, so that the states around its paths are among the demonstrations, and
the actions to be imitated are those that it would take there without noise. In further rounds what
has imitated it drives, and the expert says what it would do (DAgger, Ross, Gordon and Bagnell 2011,
arXiv 1011.0686): so the states that an imitation gets into are among them, too.
"""

from collections.abc import Callable
from typing import Literal, Self

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field, model_validator
from torch import Tensor
from tqdm import tqdm

from marl_lanes.envs.followers import find_policies
from marl_lanes.memory import check_memory
from marl_lanes.naf.checkpoint import greedy_policy
from marl_lanes.naf.network import NAFNetwork
from marl_lanes.scenario import Scenario
from marl_lanes.scenario.fields import Section
from marl_lanes.traffic.machine.state import Phase
from marl_lanes.traffic.roles.changer import CHANGER
from marl_lanes.traffic.simulator import Simulator
from marl_lanes.training.config import CountOrZero, Magnitude, Number, Sigma

NUM_ROADS = 64
"""Few, so that whole maneuvers are among a few thousand transitions."""

Expert = Callable[[NDArray[np.float32]], NDArray[np.float64]]
"""Observations (N, F) to actions (N, D)."""


class DemonstrationsConfig(Section):
    """Transitions of an expert that mu is fitted to before stage one."""

    policy: Literal["mpc", "assertive-cascade", "anticipating-cascade"] = Field(
        description="that drives"
    )
    num_transitions: CountOrZero = Field(
        description="transitions of all rounds, before the training; 0: mu is not fitted"
    )
    num_rounds: Number = Field(
        description="rounds of driving and fitting: in the first the policy drives, in the others "
        "mu as it is by then"
    )
    num_updates: Number = Field(description="updates of mu in each round, on those so far")
    batch_size: Number = Field(description="transitions an update")
    learning_rate: Magnitude = Field(description="step size at first; it falls linearly to 0")
    sigma: Sigma = Field(description="noise on the driven actions, of each action's half range [1]")

    @model_validator(mode="after")
    def _check_rounds(self) -> Self:
        if 0 < self.num_transitions < self.num_rounds:
            raise ValueError(
                f"num_rounds = {self.num_rounds}: must be at most num_transitions = "
                f"{self.num_transitions}"
            )
        return self


def learn_from_expert(
    network: NAFNetwork, scenario: Scenario, expert: Expert, config: DemonstrationsConfig, seed: int
) -> float:
    """Fit the network's mu to what an expert does, in ``num_rounds`` rounds.

    Args:
        network: whose mu is changed in place.
        scenario: in which the training collects.
        expert: that is imitated, and that drives in the first round.
        config: how many, and with which noise.
        seed: of traffic and noise.

    Returns:
        the loss of the last round, as of ``imitate``.

    Raises:
        ScenarioError, ValueError: as for ``collect_demonstrations``.
    """
    _check_room(scenario, config.num_transitions)
    ends = np.linspace(0, config.num_transitions, config.num_rounds + 1).round().astype(int)
    seeds = [seed, *np.random.SeedSequence(seed).generate_state(config.num_rounds - 1, np.uint64)]
    rounds: list[tuple[Tensor, Tensor, Tensor]] = []
    loss, driver = 0.0, None
    for wanted, of_round in zip(np.diff(ends).tolist(), seeds, strict=True):
        share = config.model_copy(update={"num_transitions": wanted})
        rounds.append(collect_demonstrations(scenario, expert, share, int(of_round), driver=driver))
        observations, actions, effective = map(torch.cat, zip(*rounds, strict=True))
        loss = imitate(network, observations, actions, effective, config)
        driver = greedy_policy(network)
    return loss


def collect_demonstrations(
    scenario: Scenario,
    expert: Expert,
    config: DemonstrationsConfig,
    seed: int,
    *,
    driver: Expert | None = None,
) -> tuple[Tensor, Tensor, Tensor]:
    """What acting agents see, and what the expert does there without noise, in one round.

    Args:
        scenario: in which the training collects.
        expert: whose actions are to be imitated.
        config: how many, and with which noise.
        seed: of traffic and noise.
        driver: whose actions are carried out, with noise; None: the expert.

    Returns:
        observations, (N, F); actions, (N, D); and which of these have an effect, (N, D), bool: the
        steering of a waiting agent has none.

    Raises:
        ScenarioError: no agent is live for too long.
        ValueError: they do not fit in memory.
    """
    wanted = config.num_transitions
    dimensions = CHANGER.act(scenario)
    low, high = (np.array([getattr(one, side) for one in dimensions]) for side in ("low", "high"))
    _check_room(scenario, wanted)
    simulator = Simulator(
        scenario, NUM_ROADS, seed=seed, follower_policies=find_policies(scenario, None)
    )
    simulator.reset()
    generator = np.random.default_rng(seed)
    actions = np.zeros_like(simulator.actions)
    seen, shown, effective = [], [], []
    num_found = num_idle = 0
    with tqdm(total=wanted, unit="tr", unit_scale=True, desc="demonstrations") as bar:
        while num_found < wanted:
            num_idle = 0 if simulator.is_live.any() else num_idle + 1
            simulator.check_wait(num_idle)
            acting = simulator.is_acting
            observations = simulator.state.observations[acting]
            actions.fill(0.0)
            if len(observations):
                chosen = expert(observations)
                seen.append(observations)
                shown.append(chosen)
                steers = simulator.state.agents["phase"][acting] != Phase.WAITING
                effective.append(
                    np.column_stack([steers, *[np.ones_like(steers)] * (low.size - 1)])
                )
                driven = chosen if driver is None else driver(observations)
                noise = config.sigma * generator.standard_normal(chosen.shape)
                actions[acting] = np.clip(driven + noise * (high - low) / 2.0, low, high)
            bar.update(min(len(observations), wanted - num_found))
            num_found += len(observations)
            simulator.step(actions)
    rows = [np.concatenate(parts)[:wanted] for parts in (seen, shown, effective)]
    return (
        torch.as_tensor(rows[0]),
        torch.as_tensor(rows[1], dtype=torch.float32),
        torch.as_tensor(rows[2]),
    )


def imitate(
    network: NAFNetwork,
    observations: Tensor,
    actions: Tensor,
    effective: Tensor,
    config: DemonstrationsConfig,
) -> float:
    """Fit the network's mu: minimum of the mean of |(mu(s) - a) / half range|^2.

    An action without effect counts as imitated. Batches are drawn by torch's generator.

    Args:
        network: whose mu is changed in place.
        observations: (N, F).
        actions: (N, D), to be imitated.
        effective: (N, D), bool, which of these have an effect.
        config: number and size of the updates.

    Returns:
        the mean over the last tenth of the updates.
    """
    policy = network.policy().module
    optimizer = torch.optim.Adam(network.mu.parameters(), lr=config.learning_rate)
    schedule = torch.optim.lr_scheduler.LinearLR(optimizer, 1.0, 0.0, config.num_updates)
    losses = []
    for _ in tqdm(range(config.num_updates), desc="imitation"):
        drawn = torch.randint(len(observations), (config.batch_size,))
        difference = (policy(observations[drawn]) - actions[drawn]) / network.box.half_range
        loss = (difference.square() * effective[drawn]).mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        schedule.step()
        losses.append(loss.detach())
    return float(torch.stack(losses[-max(1, len(losses) // 10) :]).mean())


def _check_room(scenario: Scenario, wanted: int) -> None:
    """Whether so many fit in memory, while they are put together; ValueError if not."""
    row = 4.0 * (len(CHANGER.seen(scenario)) + len(CHANGER.act(scenario)))
    check_memory("demonstrations.num_transitions", wanted, 2.0 * row * wanted)
