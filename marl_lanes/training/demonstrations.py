"""Demonstrations of an expert, and mu fitted to its actions before a training begins.

The expert drives with noise, so that the states around its paths are among the demonstrations, and
the actions to be imitated are those that it would take there without noise.
"""

from collections.abc import Callable
from typing import Literal

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field
from torch import Tensor
from tqdm import tqdm

from marl_lanes.envs.followers import find_policies
from marl_lanes.memory import check_memory
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
        description="transitions that it drives before the training; 0: mu is not fitted"
    )
    num_updates: Number = Field(description="updates of mu on them")
    batch_size: Number = Field(description="transitions an update")
    learning_rate: Magnitude = Field(description="step size at first; it falls linearly to 0")
    sigma: Sigma = Field(
        description="noise on the expert's actions, of each action's half range [1]"
    )


def collect_demonstrations(
    scenario: Scenario, expert: Expert, config: DemonstrationsConfig, seed: int
) -> tuple[Tensor, Tensor, Tensor]:
    """What acting agents see, and what the expert does there without noise.

    Args:
        scenario: in which the training collects.
        expert: that drives.
        config: how many, and with which noise.
        seed: of traffic and noise.

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
    row = 4.0 * (len(CHANGER.seen(scenario)) + low.size)
    check_memory("demonstrations.num_transitions", wanted, 2.0 * row * wanted)
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
                noise = config.sigma * generator.standard_normal(chosen.shape)
                actions[acting] = np.clip(chosen + noise * (high - low) / 2.0, low, high)
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
