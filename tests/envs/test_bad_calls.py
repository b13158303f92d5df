"""Bad calls of every public form: one clear line, and nothing has happened."""

import inspect
from importlib.util import find_spec

import numpy as np
import pytest
import torch
from external_followers import driven, until_paired
from tensordict import TensorDict

from marl_lanes import FollowerError, LaneChangeEnv, Simulator, env, parallel_env

torch.set_num_threads(1)

FORMS = (Simulator, LaneChangeEnv, parallel_env, env)
BUSY = {"command": {"probability": 1.0}, "warmup": [40.0, 40.0]}
NO_WHOLE = (True, 1.0, 1.5, "1", -1, 2**64, 1j, [0], np.nan, np.float64(1.0), np.bool_(True), b"1")
# Without its compiler, which macOS lacks, that is said first.
NO_GPU = ["cuda:99"] if find_spec("numba_cuda") else []
NO_FLAG = (1, 0.0, None, "yes", [True], np.zeros(2, bool))
WRONG = {
    "num_envs": (*NO_WHOLE, None, 0, 10**12, 10**400),
    "seed": NO_WHOLE,
    "num_threads": (*NO_WHOLE, 0, 10**9),
    "first_road": (*NO_WHOLE, None, 2**63),
    "learned_followers": NO_FLAG,
    "has_state": NO_FLAG,
    "normalised": NO_FLAG,
    "has_flat_state": NO_FLAG,
    "population": (None, "all", 3, [], True),
    "max_cycles": (*NO_WHOLE, 0),
    "follower_policies": ([], 3, "x", {"mine": 3}, {1: len}, {"mine": None}, len),
    "device": ("", "nowhere", "meta", *NO_GPU, 1.5, [], {}, torch.float32),
    "render_mode": ("ansi", 3, [], True, ["rgb_array"]),
}
OF_PETTINGZOO = {"normalised", "has_flat_state", "population", "max_cycles", "render_mode"}
OF_MANY_ROADS = {"num_envs", "num_threads", "first_road", "device"}
CALLS = [
    (form, name, value)
    for form in FORMS
    for name, values in WRONG.items()
    for value in values
    if name in inspect.signature(LaneChangeEnv if form is LaneChangeEnv else Simulator).parameters
    or (form in (parallel_env, env) and name in OF_PETTINGZOO)
    if form in (Simulator, LaneChangeEnv) or name not in OF_MANY_ROADS
]


def is_clear(error, start):
    """One line that begins with what is wrong and says what is allowed."""
    message = str(error.value)
    assert message.startswith(start), message
    assert "must be" in message, message
    assert "\n" not in message
    assert len(message) < 350


@pytest.mark.parametrize(("form", "name", "value"), CALLS)
def test_a_wrong_argument_is_named(form, name, value):
    with pytest.raises(ValueError, match=r"must be") as error:
        form("paper", **{name: value})
    is_clear(error, name)


@pytest.mark.parametrize("view", [3, [], {"sise": 1}, {"span": "wide"}, {"size": (1, 1)}])
@pytest.mark.parametrize("form", [LaneChangeEnv, parallel_env])
def test_a_wrong_view_is_refused(form, view):
    with pytest.raises(ValueError, match=r"^(options|sise|span|size).*[^\n]*$"):
        form("paper", render_mode="rgb_array", view=view)


def test_numpys_numbers_are_numbers():
    roads = LaneChangeEnv(
        "paper",
        np.int64(2),
        seed=np.uint64(2**64 - 1),
        num_threads=np.int32(2),
        first_road=np.uint8(3),
        learned_followers=np.True_,
    )
    assert roads.batch_size == (2,)
    assert roads.initial_seed == 2**64 - 1
    assert roads.simulator.roads["random_stream"].tolist() == [3, 4]
    assert roads.set_seed(np.uint64(7)) is not None
    assert roads.initial_seed == 7


def ragged(shape):
    return [[[0.0]] * shape[1], [[0.0]]]


BAD_ARRAYS = {
    "complex": lambda shape: np.zeros(shape, complex),
    "object": lambda shape: np.zeros(shape, object),
    "none": lambda shape: np.full(shape, None).tolist(),
    "text": lambda shape: np.full(shape, "0.1").tolist(),
    "bytes": lambda shape: np.full(shape, b"1"),
    "bool": lambda shape: np.zeros(shape, bool),
    "dates": lambda shape: np.zeros(shape, "M8[s]"),
    "long": lambda shape: np.zeros(shape, np.longdouble),
    "masked": lambda shape: np.ma.masked_array(np.zeros(shape), np.ones(shape, bool)),
    "record": lambda shape: np.zeros(shape, [("a", "f8")]),
    "gradient": lambda shape: torch.zeros(shape, requires_grad=True),
    "elsewhere": lambda shape: torch.zeros(shape, device="meta"),
    "huge whole numbers": lambda shape: np.full(shape, 10**400, object).tolist(),
    "ragged": ragged,
    "too deep": lambda shape: np.zeros((1, *shape)),
    "empty": lambda _: np.zeros(0),
    "number": lambda _: 0.0,
    "mapping": lambda _: {"changer_0": 0.0},
    "nan": lambda shape: np.full(shape, np.nan),
    "inf": lambda shape: np.full(shape, -np.inf, np.float16),
}
if np.dtype(np.longdouble).itemsize == 8:
    # As on Windows, where it is another name of float64.
    del BAD_ARRAYS["long"]
FORGIVEN = {"gradient", "too deep", "number"}
"""An agent's action may have any shape and may require a gradient, a batch may not."""
GOOD_ARRAYS = {
    "half": lambda shape: np.full(shape, 0.1, np.float16),
    "huge": lambda shape: np.full(shape, 1e308),
    "subnormal": lambda shape: np.full(shape, 5e-324),
    "whole": lambda shape: np.ones(shape, np.uint64),
    "lists": lambda shape: np.zeros(shape).tolist(),
    "tensor": lambda shape: torch.zeros(shape, dtype=torch.float64),
    "read-only": lambda shape: np.broadcast_to(np.float32(0.1), shape),
    "reversed": lambda shape: np.zeros(shape)[::-1],
}


@pytest.fixture(scope="module")
def steered():
    """Roads on which agents steer, and a single road."""
    roads = LaneChangeEnv("dense", 2, seed=3, overrides=BUSY, learned_followers=True)
    roads.reset()
    while not roads.simulator.is_follower_acting.any():
        roads.step(roads.rand_action())
    single = parallel_env("dense", seed=3, overrides=BUSY)
    single.reset()
    return roads, single


@pytest.mark.parametrize("kind", BAD_ARRAYS)
def test_after_a_refused_action_it_is_as_if_the_call_had_not_been(steered, kind):
    roads, single = steered
    simulator, bad = roads.simulator, BAD_ARRAYS[kind](roads.simulator.actions.shape)
    before = (simulator.snapshot(), simulator.actions.copy(), simulator.follower_actions.copy())
    with pytest.raises(ValueError, match=r"must be") as error:
        simulator.step(bad)
    is_clear(error, "actions")
    with pytest.raises(ValueError, match=r"must be") as error:
        simulator.step(np.full(simulator.actions.shape, 0.2), bad)
    is_clear(error, "follower_actions")
    assert simulator.snapshot() == before[0]
    assert (simulator.actions == before[1]).all()
    assert (simulator.follower_actions == before[2]).all()
    if kind in FORGIVEN:
        return
    agent, *others = single.agents
    frozen = single.simulator.snapshot(), single.simulator.actions.copy()
    calm = dict.fromkeys(others, np.zeros(1))
    with pytest.raises(ValueError, match=r"must be") as error:
        single.step({**calm, agent: BAD_ARRAYS[kind]((1,)) if kind != "ragged" else [[1], [1, 2]]})
    is_clear(error, f"actions['{agent}']")
    assert single.simulator.snapshot() == frozen[0]
    assert (single.simulator.actions == frozen[1]).all()


@pytest.mark.parametrize("kind", GOOD_ARRAYS)
def test_every_form_of_real_numbers_is_an_action(kind):
    roads = Simulator("paper", 2, seed=3, overrides=BUSY)
    roads.reset()
    roads.step(GOOD_ARRAYS[kind](roads.actions.shape))
    expected = np.asarray(GOOD_ARRAYS[kind](roads.actions.shape), np.float64)
    assert (roads.actions == expected).all()
    single = parallel_env("paper", seed=3, overrides=BUSY)
    single.reset()
    single.step({agent: GOOD_ARRAYS[kind]((1,)) for agent in single.agents})


@pytest.mark.parametrize("actions", [None, [], 3, "changer_0", np.zeros(1), print])
def test_actions_are_a_mapping(steered, actions):
    with pytest.raises(ValueError, match=r"^actions = .*: must be a mapping of agents"):
        steered[1].step(actions)


@pytest.mark.parametrize(
    "action",
    [
        torch.zeros(2, 16, 1, dtype=torch.complex64),
        torch.zeros(2, 16, 1, dtype=torch.bool),
        torch.full((2, 16, 1), torch.nan),
        torch.zeros(2, 16, 2),
        torch.zeros(2, 16),
        None,
    ],
)
def test_a_refused_step_of_tensors_changes_nothing(steered, action):
    roads, _ = steered
    before = roads.simulator.snapshot()
    given = roads.rand_action()
    del given["changers", "action"]
    if action is not None:
        given["changers", "action"] = action
    with pytest.raises(ValueError, match=r"^actions?\b.*must be [^\n]*$"):
        roads.step(given)
    assert roads.simulator.snapshot() == before
    roads.restore(before)
    with pytest.raises(ValueError, match="must be"):
        roads.step(given)
    # It is still the restored state that a reset returns.
    assert roads.reset()["changers", "mask"].any()
    assert roads.simulator.snapshot() == before


def test_tensors_of_every_real_type_are_actions():
    roads = LaneChangeEnv("paper", 2, seed=3, overrides=BUSY)
    roads.reset()
    shape = roads.simulator.actions.shape
    for dtype in (torch.float16, torch.bfloat16, torch.float64, torch.int64):
        action = torch.zeros(shape, dtype=dtype)
        roads.step(TensorDict({"changers": {"action": action}}, [2]))
    action = torch.zeros(shape, requires_grad=True)
    assert not roads.step(TensorDict({"changers": {"action": action}}, [2]))["next"].requires_grad


@pytest.mark.parametrize("mask", [[1, 0], [0.5, 0.5], ["a", "b"], [None, None], [True], True, {}])
def test_a_mask_is_truth_values(steered, mask):
    simulator = steered[0].simulator
    before = simulator.snapshot()
    with pytest.raises(ValueError, match=r"^mask.*must be") as error:
        simulator.reset(mask)
    is_clear(error, "mask")
    assert simulator.snapshot() == before


@pytest.mark.parametrize("seed", NO_WHOLE)
def test_a_wrong_seed_of_a_reset_changes_nothing(steered, seed):
    roads, single = steered
    before = roads.simulator.snapshot(), single.simulator.snapshot()
    for call in (roads.set_seed, roads.simulator.seed, lambda seed: single.reset(seed=seed)):
        with pytest.raises(ValueError, match=r"^seed = [^\n]*: must be a whole number, 0 to"):
            call(seed)
    assert (roads.simulator.snapshot(), single.simulator.snapshot()) == before


class Policy:
    """Keeps its speed, but for one call in which it does something else."""

    def __init__(self):
        self.instead = None

    def __call__(self, observations):
        if self.instead is not None:
            return self.instead(observations)
        return np.zeros(len(observations))


@pytest.fixture(scope="module")
def followed():
    policy = Policy()
    simulator = driven(policy, num_envs=2)
    until_paired(simulator)
    return simulator, policy


def fail(_):
    raise KeyError("mine")


@pytest.mark.parametrize(
    ("instead", "error", "message"),
    [
        (fail, KeyError, "mine"),
        (lambda seen: seen.fill(np.nan), FollowerError, "follower 'mine': returned"),
        (lambda seen: np.full(len(seen), 1j), FollowerError, "follower 'mine': returned"),
        (
            lambda seen: torch.zeros(len(seen), requires_grad=True),
            FollowerError,
            "'mine': returned",
        ),
        (lambda seen: np.full(len(seen), 1e308), FollowerError, "follower 'mine': returned 1e"),
        (lambda _: {"mine": 0.0}, FollowerError, "follower 'mine': returned"),
    ],
)
def test_a_policy_that_fails_changes_nothing(followed, instead, error, message):
    simulator, policy = followed
    before = simulator.snapshot()
    policy.instead = instead
    try:
        with pytest.raises(error, match=message):
            simulator.step()
    finally:
        policy.instead = None
    assert simulator.snapshot() == before


@pytest.mark.parametrize("call", ["step", "advance", "reset", "seed", "snapshot"])
def test_a_policy_cannot_call_the_roads_that_ask_it(followed, call):
    simulator, policy = followed
    before = simulator.snapshot()
    policy.instead = lambda _: getattr(simulator, call)()
    try:
        with pytest.raises(RuntimeError, match=rf"^Simulator\.{call}: another call is in progress"):
            simulator.step()
    finally:
        policy.instead = None
    assert simulator.snapshot() == before
    simulator.step()


def test_a_policy_may_write_to_what_it_sees(followed):
    simulator, policy = followed
    before = simulator.state.follower_observations.copy()
    policy.instead = lambda seen: [seen.fill(7.0), np.zeros(len(seen))][1]
    twin = Simulator(
        simulator.scenario, 2, seed=0, follower_policies={"mine": lambda seen: 0.0 * seen[:, 0]}
    )
    twin.restore(simulator.snapshot())
    try:
        simulator.step()
    finally:
        policy.instead = None
    twin.step()
    assert simulator.snapshot() == twin.snapshot()
    assert (before != 7.0).all()
