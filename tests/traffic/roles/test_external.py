"""Followers that a registered policy drives: registry, checks, guard, reward."""

import numpy as np
import pytest
import torch
from staging import command, stage
from tensordict import TensorDict

import marl_lanes.traffic.roles.external as external
from marl_lanes import LaneChangeEnv, ScenarioError, Simulator, parallel_env, register_follower
from marl_lanes.traffic.machine.state import Disposition, Phase
from marl_lanes.traffic.roles.external import FOLLOWER_COLUMNS, FollowerError

torch.set_num_threads(1)

OPEN_GAP = {"rule": "kinematic", "minimum_gap": 0.0, "time_gap": 0.0, "max_braking": 1000.0}
BUSY = {"departures": {"interval": [1.5, 3.0]}, "command": {"probability": 1.0}}


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
        scenario, num_envs, overrides={**followers, **overrides}, follower_policies={"mine": policy}
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


@pytest.fixture(autouse=True)
def registry(monkeypatch):
    monkeypatch.setattr(external, "_registered", {})


@pytest.mark.parametrize(
    "name", ["cooperative", "neutral", "adversarial", "learned", "", "1st", "a b", "a.b", "größe"]
)
def test_an_invalid_name_is_refused(name):
    with pytest.raises(ValueError, match="must be letters, digits, _ and -"):
        register_follower(name, brake_checker)
    assert external._registered == {}


def test_a_policy_that_cannot_be_called_is_refused():
    with pytest.raises(TypeError, match="'mine': its policy must be callable, got 3"):
        register_follower("mine", 3)


@pytest.mark.parametrize("form", [Simulator, parallel_env, LaneChangeEnv])
def test_a_name_without_a_policy_is_refused(form):
    register_follower("another", brake_checker)
    for name in ("brake-checker", "learned"):
        problem = rf"followers\.mix: '{name}' has no policy; allowed: cooperative.*\(another\)"
        with pytest.raises(ScenarioError, match=problem):
            form("paper", overrides=mixed(name))


def test_a_registered_name_drives_the_same_road_in_every_form():
    calls = []

    def counted(observations):
        calls.append(len(observations))
        return brake_checker(observations)

    register_follower("brake-checker", counted)
    overrides = {**mixed("brake-checker", "neutral"), **BUSY, "num_agents": 12}
    simulator = Simulator("paper", overrides=overrides, seed=5)
    simulator.reset()
    expected = {}
    while not simulator.roads["is_done"][0]:
        expected[int(simulator.roads["step"][0])] = simulator.vehicles[0].tobytes()
        advance(simulator)
    expected[int(simulator.roads["step"][0])] = simulator.vehicles[0].tobytes()
    num_calls = len(calls)
    assert num_calls > 30

    single = parallel_env("paper", overrides=overrides, seed=5)
    observations, _ = single.reset()
    while single.agents:
        step = int(single.simulator.roads["step"][0])
        assert single.simulator.vehicles[0].tobytes() == expected[step]
        actions = {name: steer(observations[name][None])[0] for name in single.agents}
        observations = single.step(actions)[0]
    assert single.simulator.vehicles[0].tobytes() == expected[max(expected)]
    assert len(calls) == 2 * num_calls

    batched = LaneChangeEnv("paper", 2, overrides=overrides, seed=5)
    current, is_over = batched.reset(), False
    while not is_over:
        group = current["changers"]
        seen = group["observation"].numpy()
        action = steer(seen.reshape(-1, 6)).reshape(*group.shape, 1)
        action = torch.from_numpy(action) * group["steering"][..., None]
        given = TensorDict({"changers": {"action": action.float()}}, batched.batch_size)
        # float32, like the actions of steer in the other forms.
        current = batched.step(given)["next"]
        is_over = bool(current["done"][0])
        step = int(batched.simulator.roads["step"][0])
        assert batched.simulator.vehicles[0].tobytes() == expected[step]

    plain = Simulator("paper", overrides={**overrides, **mixed("neutral")}, seed=5)
    plain.reset()
    while not plain.roads["is_done"][0]:
        advance(plain)
    assert plain.vehicles[0].tobytes() != expected[max(expected)]


def test_given_policies_come_before_registered_ones():
    register_follower("mine", lambda seen: np.full(len(seen), np.nan))
    simulator = driven(brake_checker)
    until_paired(simulator)
    advance(simulator)
    # The nan of the registered policy would have been refused.
    assert np.isfinite(simulator.follower_actions).all()


@pytest.mark.parametrize(
    ("returned", "problem"),
    [
        (lambda n: np.full(n, np.nan), "returned nan for row 0, must be a finite acceleration"),
        (lambda n: np.full(n, np.inf), "returned inf for row 0, must be a finite"),
        (lambda n: np.full(n, 3.01), r"returned 3\.01 for row 0, .*between -3\.0 and 3\.0 m/s\^2"),
        (lambda n: np.full(n, -3.01), r"returned -3\.01 .*\(followers\.external\); it saw {'speed"),
        (lambda n: np.zeros((n, 1)), r"returned shape \(\d+, 1\), must be \(\d+,\)"),
        (lambda n: np.zeros(n + 1), r"returned shape \(\d+,\), must be \(\d+,\)"),
        (lambda _: 0.0, r"returned shape \(\), must be"),
        (lambda _: None, "returned"),
        (lambda n: ["fast"] * n, r"returned \['fast'.* must be \d+ numbers"),
        (lambda n: [object()] * n, r"returned \[<object .* must be \d+ numbers"),
    ],
)
def test_invalid_accelerations_are_refused(returned, problem):
    simulator = driven(lambda observations: returned(len(observations)))
    until_paired(simulator)
    before = simulator.snapshot()
    with pytest.raises(FollowerError, match=rf"follower 'mine': {problem}"):
        simulator.step()
    # The refused step has changed nothing, and is refused again.
    assert simulator.snapshot() == before
    with pytest.raises(FollowerError, match=problem):
        simulator.step()


def test_rounding_of_a_bounded_output_is_no_error():
    simulator = driven(
        lambda observations: np.full(len(observations), -3.0 - 1e-6, np.float32), guarded=False
    )
    until_paired(simulator)
    (envs, slots), _ = advance(simulator)
    assert (simulator.vehicles[envs, slots]["acceleration"] == -3.0).all()


def test_an_unguarded_policys_acceleration_is_the_vehicles():
    simulator = driven(brake_checker, guarded=False)
    found, wanted = [], []
    for _ in range(600):
        (envs, slots), seen = advance(simulator)
        found += simulator.vehicles[envs, slots]["acceleration"].tolist()
        wanted += brake_checker(seen).tolist()
    assert len(found) > 300
    assert found == wanted
    assert set(found) == {-3.0, 1.5}


def test_the_guard_only_lowers_a_policys_acceleration():
    simulator = driven(brake_checker)
    found, wanted = [], []
    for _ in range(600):
        (envs, slots), seen = advance(simulator)
        found += simulator.vehicles[envs, slots]["acceleration"].tolist()
        wanted += brake_checker(seen).tolist()
    found, wanted = np.asarray(found), np.asarray(wanted)
    assert (found <= wanted).all()
    assert (found >= -8.0).all()
    assert 0.0 < (found < wanted).mean() < 0.5
    assert (found == -3.0).any()


def test_no_follower_accelerates_beyond_the_speed_limit():
    limit = {"mix": {"mine": 1.0}, "external": {"is_guarded": False, "max_speed": 12.0}}
    policies = {"mine": lambda observations: np.full(len(observations), 3.0)}
    simulator = Simulator(
        "dense", 4, overrides={"followers": limit}, follower_policies=policies, seed=1
    )
    simulator.reset()
    at_limit = 0
    for _ in range(400):
        (envs, slots), seen = advance(simulator)
        cars, before = simulator.vehicles[envs, slots], seen[:, FOLLOWER_COLUMNS["speed"]]
        slow = before < 12.0
        assert (cars["speed"][slow] <= 12.0 + 1e-9).all()
        assert (cars["acceleration"][~slow] <= 1e-6).all()
        at_limit += len(before)
    assert at_limit > 300


def count_collisions(guarded):
    policy = {"mine": lambda observations: np.full(len(observations), 3.0)}
    followers = mixed("mine", external={"is_guarded": guarded})
    simulator = Simulator(
        "dense",
        100,
        overrides={**followers, "num_agents": 20, "gap": {"rule": "kinematic"}},
        follower_policies=policy,
    )
    simulator.reset()
    num_paired = 0
    while not simulator.roads["is_done"].all():
        rows, _ = advance(simulator)
        num_paired += len(rows[0])
    return int(simulator.roads["num_collisions"].sum()), num_paired


@pytest.mark.slow
def test_only_with_the_guard_a_reckless_policy_does_not_collide():
    """2,000 maneuvers with followers that always want 3 m/s^2, with and without the guard."""
    collisions, num_paired = count_collisions(guarded=True)
    assert num_paired > 20_000
    assert collisions == 0
    collisions, _ = count_collisions(guarded=False)
    assert collisions > 100


# One staged pair: the driver's reward.

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
TERMS = [
    f"reward_{name}" for name in ("delay", "abort", "collision", "discomfort", "braking")
]  # fmt: skip


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


def test_a_driver_with_a_command_of_its_own_is_not_external():
    simulator, slot = pair_of()
    assert simulator.state.followers[0, slot]["vehicle"] == 0
    assert simulator.is_follower_acting[0, slot]
    simulator, slot = pair_of(commanded=True)
    assert simulator.agents[0, slot]["target_follower"] == 0
    assert simulator.vehicles[0, 0]["changer"] == 1
    assert (simulator.state.followers["vehicle"] == -1).all()
    assert not simulator.is_follower_acting.any()
    assert pay(simulator, slot, 3.0) == [0.0] * 5
    assert simulator.vehicles[0, 0]["acceleration"] < 3.0


def test_before_the_body_is_in_the_lane_the_delay_is_rewarded():
    terms = pay(*pair_of(), 0.5)
    assert terms == pytest.approx([DELAY * 0.1, 0.0, 0.0, -DISCOMFORT * 0.25, 0.0])


def test_braking_beyond_hard_braking_costs_reward():
    terms = pay(*pair_of(), -2.5)
    assert terms == pytest.approx([DELAY * 0.1, 0.0, 0.0, -DISCOMFORT * 6.25, -BRAKING * 1.5])


def test_once_the_body_is_in_the_lane_there_is_no_delay():
    terms = pay(*pair_of(lateral=7.0), -0.5)
    assert terms == pytest.approx([0.0, 0.0, 0.0, -DISCOMFORT * 0.25, 0.0])


def test_an_abort_is_rewarded_once_and_ends_the_pairing():
    guard = {**OPEN_GAP, "minimum_gap": 2.0}
    simulator, slot = pair_of(gap=2.35, speeds=(20.0, 18.0), guard=guard)
    assert simulator.is_follower_acting[0, slot]
    terms = pay(simulator, slot, 3.0)
    assert simulator.agents[0, slot]["phase"] == Phase.ABORTING
    assert terms == pytest.approx([DELAY * 0.1, ABORT, 0.0, -DISCOMFORT * 9.0, 0.0])
    assert not simulator.is_follower_acting[0, slot]
    total = simulator.state.followers[0, slot]["episode_reward"]
    assert pay(simulator, slot, 3.0) == [0.0] * 5
    assert simulator.state.followers[0, slot]["episode_reward"] == total


def test_a_collision_costs_its_penalty():
    simulator, slot = pair_of(gap=1.6, speeds=(25.0, 14.0), lateral=8.5)
    assert simulator.is_follower_acting[0, slot]
    terms = pay(simulator, slot, 3.0)
    assert simulator.roads["num_collisions"][0] == 1
    assert simulator.has_ended[0, slot]
    assert terms == pytest.approx([0.0, 0.0, -COLLISION, -DISCOMFORT * 9.0, 0.0])
