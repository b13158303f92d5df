"""Episodes of the PettingZoo environment: policies, and what an episode returns."""

import numpy as np

from marl_lanes.traffic.machine.state import Phase

BUSY = {"departures": {"interval": [1.5, 3.0]}, "command": {"probability": 1.0}}
LONG = 100_000
"""Steps that no episode takes."""


def steer(observation):
    """Feedback of the paper's features toward the target lane; it completes most changes.

    Where there are more features, the last but one is what car following would do.
    """
    speed, _, deviation, yaw, yaw_rate, curvature, *others = observation.tolist()
    wanted = min(max(0.5 * deviation, -2.0), 2.0) / max(speed, 1.0)
    action = 2.0 * (wanted - yaw) - 2.0 * (yaw_rate - curvature * speed)
    return np.array([action, *others[-2:-1]], np.float32)


def hold(_):
    return np.zeros(1, np.float32)


def play(road, policy=steer, **reset):
    """Steps of an episode: the agents before each step, and the results of reset and steps."""
    observations, infos = road.reset(**reset)
    empty = dict.fromkeys(observations, 0.0), dict.fromkeys(observations, False)
    frames = [([], observations, empty[0], empty[1], empty[1], infos)]
    for _ in range(LONG):
        if not road.agents:
            return frames
        before = list(road.agents)
        actions = {agent: policy(observations[agent]) for agent in before}
        observations, *others = road.step(actions)
        frames.append((before, observations, *others))
    raise AssertionError("the episode does not end")


def transcript(road, policy=steer, **reset):
    """Every byte that an episode returns, state() included."""
    observations, infos = road.reset(**reset)
    lines = [repr(infos)]
    while road.agents:
        lines += [f"{name}:{seen.tobytes().hex()}" for name, seen in observations.items()]
        lines.append(road.state().tobytes().hex())
        actions = {agent: policy(observations[agent]) for agent in road.agents}
        observations, *others = road.step(actions)
        lines.append(repr(others))
    return lines


def until_engaged(road, seed=0):
    observations, infos = road.reset(seed=seed)
    while not any(info["phase"] == Phase.ENGAGED for info in infos.values()):
        observations, _, _, _, infos = road.step({agent: hold(None) for agent in road.agents})
    return observations, infos
