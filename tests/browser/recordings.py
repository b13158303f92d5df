"""Recorded roads for tests of the page."""

import numpy as np

from marl_lanes import Simulator, load_scenario
from marl_lanes.evaluation.policies import make_tuned_cascade_policy
from marl_lanes.trajectory.file import Trajectory, make_trajectory
from marl_lanes.trajectory.frames import FrameReader
from marl_lanes.trajectory.metadata import Metadata


def record(scenario, num_steps, *, num_roads=1, seed=0) -> Trajectory:
    """Roads that the tuned cascade drives."""
    simulator = Simulator(load_scenario(scenario), num_roads, seed=seed)
    simulator.reset()
    policy = make_tuned_cascade_policy(simulator.scenario)
    reader = FrameReader(simulator)
    blocks = [reader.read()]
    for _ in range(num_steps):
        acting = simulator.is_acting
        actions = np.zeros((*acting.shape, simulator.num_actions))
        if acting.any():
            actions[acting] = policy(simulator.state.observations[acting])
        simulator.step(actions)
        blocks.append(reader.read())
    return make_trajectory(Metadata(simulator.scenario, seed, "tuned-cascade"), blocks)
