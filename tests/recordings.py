"""Recorded roads, for tests of what stands on trajectories."""

from functools import cache
from itertools import islice

from marl_lanes import Simulator, load_scenario
from marl_lanes.evaluation import driving
from marl_lanes.evaluation.policies import make_tuned_cascade_policy
from marl_lanes.trajectory.file import make_trajectory
from marl_lanes.trajectory.frames import FrameReader
from marl_lanes.trajectory.metadata import Metadata


def drive(simulator, steps, policy=None):
    """Step with the tuned cascade, or another policy; yields after the reset and each step."""
    yield
    policy = policy or make_tuned_cascade_policy(simulator.scenario)
    yield from islice(driving.drive(simulator, policy), steps)


def record(
    scenario="paper", steps=300, *, overrides=None, seed=0, num_envs=1, roads=None, policy=None
):
    """The trajectory of roads that are reset and then stepped."""
    loaded = load_scenario(scenario, overrides)
    simulator = Simulator(loaded, num_envs, seed=seed)
    simulator.reset()
    reader = FrameReader(simulator, roads)
    blocks = [reader.read() for _ in drive(simulator, steps, policy)]
    return make_trajectory(Metadata(loaded, seed, "tuned-cascade"), blocks)


@cache
def paper():
    """One road of the paper's scenario; some commands are over."""
    return record("paper", 800)


@cache
def interactive():
    """One road of dense traffic with aborts and two actions."""
    return record("interactive", 500)


def cross(observations):
    """A policy that crosses all lanes and the road's edge (for the scenario of ``crashes``)."""
    yaw, yaw_rate = observations[:, 3:4], observations[:, 4:5]
    return 4.0 * (0.15 - yaw) - 4.0 * yaw_rate


CROWDED = {"departures": {"interval": [1.5, 3.0]}, "max_vehicles": 256}
"""Of five lanes, so that who crosses them hits someone."""


@cache
def crashes():
    """Roads on which changers are lost or collide."""
    return record("five_lanes", 250, overrides=CROWDED, num_envs=6, policy=cross)
