"""Followers that a registered policy drives: the registry and the checks."""

import numpy as np
import pytest
import torch
from external_followers import advance, brake_checker, driven, mixed, steer, until_paired
from tensordict import TensorDict

import marl_lanes.traffic.roles.external as external
from marl_lanes import LaneChangeEnv, ScenarioError, Simulator, parallel_env, register_follower
from marl_lanes.traffic.roles.external import FollowerError

torch.set_num_threads(1)

BUILT_IN = dict(external._registered)
BUSY = {"departures": {"interval": [1.5, 3.0]}, "command": {"probability": 1.0}}


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
        problem = rf"followers\.mix: '{name}' has no policy; allowed: cooperative.*, another, or"
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


def seen(**columns):
    """An observation for every value, zero in the other columns."""
    (count,) = {len(values) for values in columns.values()}
    rows = np.zeros((count, len(external.FOLLOWER_COLUMNS)), np.float32)
    for name, values in columns.items():
        rows[:, external.FOLLOWER_COLUMNS[name]] = values
    return rows


def test_a_brake_checker_closes_in_and_then_brakes():
    rows = seen(gap=[20.0, 8.5, 7.5, 9.5, 9.5], relative_speed=[0.0, 0.0, 0.0, -4.0, 4.0])
    assert external.check_brakes(rows).tolist() == [2.0, 2.0, -3.0, -3.0, 2.0]


def test_a_late_yielder_closes_up_until_the_changer_is_at_the_marking():
    rows = seen(
        speed=[20.0] * 6,
        gap=[30.0, 5.0, 5.0, 30.0, 20.0, 32.0],
        relative_speed=[0.0, 0.0, -1.0, 0.0, 0.0, 1.0],
        changer_lateral_deviation=[3.75, 3.75, 3.0, 2.7, 0.0, -0.1],
    )
    found = external.yield_late(rows)
    assert found == pytest.approx([2.0, 0.0, -0.8, -0.6, -3.0, 0.8], abs=1e-6)


@pytest.mark.parametrize("name", ["brake-checker", "late-yielder"])
def test_followers_with_names_need_no_registration(monkeypatch, name):
    monkeypatch.setattr(external, "_registered", BUILT_IN)
    unguarded = mixed(name, external={"is_guarded": False})
    simulator = Simulator("dense", 4, overrides=unguarded, seed=0)
    simulator.reset()
    found, wanted = [], []
    for _ in range(300):
        (envs, slots), observed = advance(simulator)
        found += simulator.vehicles[envs, slots]["acceleration"].tolist()
        wanted += BUILT_IN[name](observed).tolist()
    assert len(found) > 50
    assert found == wanted


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
        (lambda n: np.zeros((n, 1)), r"returned: shape \(\d+, 1\), must be \(\d+,\)"),
        (lambda n: np.zeros(n + 1), r"returned: shape \(\d+,\), must be \(\d+,\)"),
        (lambda _: 0.0, r"returned: shape \(\), must be"),
        (lambda _: None, "returned"),
        (lambda n: ["fast"] * n, r"returned = \['fast'.*: must be real numbers"),
        (lambda n: [object()] * n, r"returned = \[<object .*: must be real numbers"),
        (lambda n: np.full(n, 1j), "returned = array.*: must be real numbers"),
        (lambda n: np.zeros(n, bool), "returned = array.*: must be real numbers"),
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
