"""Roads with followers that a policy drives, and one placed pair of a follower and a changer."""

import numpy as np
import pytest
from staging import command, stage

from marl_lanes import Simulator
from marl_lanes.traffic.machine.state import Disposition, Phase
from marl_lanes.traffic.roles.external import FOLLOWER_COLUMNS

OPEN_GAP = {"rule": "kinematic", "minimum_gap": 0.0, "time_gap": 0.0, "max_braking": 1000.0}


def brake_checker(observations):
    """Accelerates up to the changer, then brakes hard."""
    return np.where(observations[:, FOLLOWER_COLUMNS["gap"]] < 15.0, -3.0, 1.5)


def steer(observations):
    """Feedback from the paper's features toward the reference lane, (n, 6) to (n, 1)."""
    speed, _, deviation, yaw, yaw_rate, curvature = observations.T
    wanted = np.clip(0.5 * deviation, -2.0, 2.0) / np.maximum(speed, 1.0)
    return (2.0 * (wanted - yaw) - 2.0 * (yaw_rate - curvature * speed))[:, None]


def mixed(*names, **parts):
    return {"followers": {"mix": dict.fromkeys(names, 1.0), **parts}}


def driven(policy, scenario="dense", num_envs=4, *, guarded=True, **overrides):
    """Roads on which the policy drives all followers."""
    followers = mixed("mine", external={"is_guarded": guarded})
    simulator = Simulator(
        scenario,
        num_envs,
        overrides={**followers, **overrides},
        follower_policies={"mine": policy},
        seed=0,
    )
    simulator.reset()
    return simulator


def advance(simulator):
    """One step with ``steer``; vehicle slots and observations of the drivers paired before it."""
    state = simulator.state
    paired = state.followers["vehicle"] >= 0
    rows = np.nonzero(paired)[0], state.followers["vehicle"][paired]
    seen, engaged = state.follower_observations[paired].copy(), simulator.is_steering
    actions = np.zeros((*engaged.shape, 1))
    actions[engaged] = steer(state.observations[engaged])
    simulator.step(actions)
    return rows, seen


def until_paired(simulator):
    while not (simulator.state.followers["vehicle"] >= 0).any():
        advance(simulator)


EXTERNAL = int(Disposition.EXTERNAL)
DELAY, ABORT, COLLISION, DISCOMFORT, BRAKING = 0.3, 2.0, 7.0, 0.01, 0.5
WEIGHTS = {
    "delay_weight": DELAY,
    "abort_weight": ABORT,
    "collision_penalty": COLLISION,
    "discomfort_weight": DISCOMFORT,
    "braking_weight": BRAKING,
    "hard_braking": 1.0,
}


def pair_of(*, gap=30.0, speeds=(20.0, 20.0), lateral=5.625, guard=OPEN_GAP, commanded=False):
    """A learned driver in lane 2 of five, behind a changer in lane 1 that is engaged."""
    simulator = Simulator(
        "five_lanes",
        learned_followers=True,
        overrides={
            "warmup": [0.0, 0.0],
            "gap": guard,
            "followers": {
                "external": {"is_guarded": False},
                "learned": {"adversarial": WEIGHTS},
            },
        },
        seed=0,
    )
    simulator.reset()
    driver = {"lane": 2, "position": 100.0, "speed": speeds[0], "disposition": EXTERNAL}
    changer = {"lane": 1, "position": 104.8 + gap, "speed": speeds[1], "lateral_position": lateral}
    stage(simulator, driver, changer)
    if commanded:
        command(simulator, 0, 1, Phase.WAITING)
    slot = command(simulator, 1, 1)
    simulator.step()
    return simulator, slot


def pay(simulator, slot, acceleration):
    """The terms of a step with this action; their sum is the reward."""
    actions = np.zeros((1, simulator.num_slots, 1))
    actions[0, slot] = acceleration
    before = simulator.state.followers[0, slot]["episode_reward"]
    simulator.step(None, actions)
    record = simulator.state.followers[0, slot]
    terms = record["terms"].tolist()
    assert record["reward"] == pytest.approx(sum(terms), abs=1e-12)
    assert record["episode_reward"] == pytest.approx(before + sum(terms), abs=1e-12)
    return terms
