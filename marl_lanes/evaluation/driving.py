"""The one loop in which a policy drives the lane changers of seeded roads."""

from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from marl_lanes.traffic.simulator import Simulator

Policy = Callable[[NDArray[np.float32]], NDArray[np.float64]]
"""Observations of N acting agents, (N, F), to their actions, (N, D)."""


def drive(simulator: Simulator, policy: Policy) -> Iterator[None]:
    """Step all roads without end, with the policy's actions.

    The policy is asked only when the next step is asked for, so that what reads the roads after a
    step also reads them before the next one.

    Args:
        simulator: that has been reset.
        policy: for every agent whose action is used: it steers, or waits if actions are (N, 2).

    Yields:
        after every step.
    """
    actions = np.zeros((simulator.num_envs, simulator.num_slots, simulator.num_actions))
    while True:
        acting = simulator.is_acting
        actions.fill(0.0)
        if acting.any():
            actions[acting] = policy(simulator.state.observations[acting])
        simulator.step(actions)
        yield
