"""Rollouts of the TorchRL environment: busy roads, policies of tensors, comparison."""

import torch
from tensordict import assert_close
from tensordict.nn import TensorDictModule

BUSY = {
    "num_agents": None,
    "horizon": None,
    "departures": {"interval": [1.5, 3.0]},
    "command": {"probability": 1.0},
    "num_slots": 3,
}
"""Roads without end, whose slots are in steady use."""
SHORT = {"num_agents": 2, "departures": {"interval": [1.5, 3.0]}, "command": {"probability": 1.0}}
"""Episodes of two commands."""
LONG = 100_000
"""Steps that no episode takes."""


def feedback(observation):
    """Feedback of the paper's features toward the target lane."""
    speed, _, deviation, yaw, yaw_rate, curvature = observation.unbind(-1)
    wanted = (0.5 * deviation).clamp(-2.0, 2.0) / speed.clamp(min=1.0)
    action = 2.0 * (wanted - yaw) - 2.0 * (yaw_rate - curvature * speed)
    return action.clamp(-0.5, 0.5).unsqueeze(-1)


def policy(function):
    return TensorDictModule(function, [("changers", "observation")], [("changers", "action")])


steer = policy(feedback)
hold = policy(lambda observation: torch.zeros_like(observation[..., :1]))


def roll(env, steps, module=steer, **kwargs):
    return env.rollout(steps, module, break_when_any_done=False, **kwargs)


def assert_equal(one, other):
    assert_close(one, other, rtol=0.0, atol=0.0)
