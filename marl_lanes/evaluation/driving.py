"""The one loop in which a policy drives the lane changers of seeded roads."""

from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from marl_lanes.scenario import Scenario, ScenarioError, load_scenario
from marl_lanes.traffic.simulator import Simulator

Policy = Callable[[NDArray[np.float32]], NDArray[np.float64]]
"""Observations of N acting agents, (N, F), to their actions, (N, D)."""


def drive(simulator: Simulator, policy: Policy, *, needs_agents: bool = False) -> Iterator[None]:
    """Step all roads without end, with the policy's actions.

    The policy is asked only when the next step is asked for, so that what reads the roads after a
    step also reads them before the next one.

    Args:
        simulator: that has been reset.
        policy: for every agent whose action is used: it steers, or waits if actions are (N, 2).
        needs_agents: whether it is an error if no agent is live for too long.

    Yields:
        after every step.

    Raises:
        ScenarioError: no agent is live for too long (``Simulator.check_wait``).
    """
    num_idle = 0
    actions = np.zeros((simulator.num_envs, simulator.num_slots, simulator.num_actions))
    while True:
        masks = simulator.masks
        num_idle = 0 if masks.live.any() else num_idle + 1
        if needs_agents:
            simulator.check_wait(num_idle)
        acting = masks.acting
        actions.fill(0.0)
        if acting.any():
            actions[acting] = policy(simulator.state.observations[acting])
        simulator.step(actions)
        yield


def check_first_command(scenario: Scenario, num_roads: int, seed: int) -> None:
    """Refuse episodes that end before any vehicle is commanded.

    Until the first command nobody acts, so no policy is needed to know it.

    Args:
        scenario: with a horizon, or without one.
        num_roads: of the evaluation.
        seed: of its traffic.

    Raises:
        ScenarioError: nobody is commanded on any road.
    """
    if scenario.horizon is None:
        return
    alone = load_scenario(scenario, {"followers": {"mix": {"neutral": 1.0}}})
    simulator = Simulator(alone, num_roads, seed=seed)
    simulator.reset()
    simulator.advance_until_live()
    if not simulator.is_live.any():
        raise ScenarioError(
            f"scenario {scenario.name!r}: horizon = {scenario.horizon}: must be longer; on "
            f"{num_roads} roads it ends before the first command (command.probability = "
            f"{scenario.command.probability:g}, command.position = "
            f"{list(scenario.command.position)})"
        )
