"""Roads on a GPU are those on the CPU; benchmarks/gpu.py runs this. Left out without a GPU."""

import copy
import pickle

import numpy as np
import pytest
from devices import LONGITUDINAL, assert_close, assert_same, draw, needs_gpu

from marl_lanes import Simulator, list_scenarios
from marl_lanes.traffic.roles.external import check_brakes, yield_late

NUM_ROADS = 48
NUM_STEPS = 1000
"""Roads enough that all branches are taken."""

pytestmark = needs_gpu


def make(scenario, device, *, num_envs=NUM_ROADS, seed=5, **options):
    simulator = Simulator(scenario, num_envs, seed=seed, num_threads=1, device=device, **options)
    simulator.reset()
    return simulator


def make_both(scenario="paper", **options):
    return [make(scenario, device, **options) for device in ("cpu", "cuda")]


def drive(rng, simulators, num_steps, has_followers=False):
    for _ in range(num_steps):
        actions = draw(rng, simulators[0])
        followers = rng.uniform(-4.0, 4.0, (*actions.shape[:2], 1)) if has_followers else None
        for simulator in simulators:
            simulator.step(actions, followers)


@pytest.mark.parametrize("longitudinal", [None, LONGITUDINAL], ids=["lateral", "both"])
@pytest.mark.parametrize("scenario", list_scenarios())
def test_every_scenario_after_a_thousand_steps(scenario, longitudinal):
    overrides = {
        "action": {"longitudinal": longitudinal},
        "num_agents": None,
        "horizon": None,
        "command": {"probability": 1.0},
    }
    both = make_both(scenario, overrides=overrides)
    assert_same(*both)
    drive(np.random.default_rng(1), both, NUM_STEPS)
    assert_same(*both)
    here = both[0]
    assert here.roads["num_commands"].sum() > NUM_ROADS
    assert (here.agents["episode_reward"] != 0.0).any()


def test_a_thousand_steps_with_masked_resets_and_an_end_of_the_episodes():
    both = make_both("dense", overrides={"horizon": 60.0, "command": {"probability": 1.0}})
    rng = np.random.default_rng(2)
    for _ in range(10):
        drive(rng, both, NUM_STEPS // 10)
        mask = rng.random(NUM_ROADS) < 0.4
        for simulator in both:
            simulator.reset(mask)
        assert_same(*both)
        assert (both[0].roads["step"][mask] == 0).all()


def test_learned_followers():
    both = make_both("interactive", learned_followers=True)
    drive(np.random.default_rng(3), both, NUM_STEPS, has_followers=True)
    assert_same(*both)
    assert both[0].is_follower_acting.any()
    assert_close("follower_actions", both[0].follower_actions, both[1].follower_actions)


def test_registered_followers():
    """They see float32, which of two close float64 may make two others: these look less closely."""

    def rounding(policy):
        return lambda observations: policy(np.round(observations, 3))

    policies = {"checks": rounding(check_brakes), "late": rounding(yield_late)}
    both = make_both(
        "interactive",
        overrides={"followers": {"mix": {"checks": 0.5, "late": 0.5}}},
        follower_policies=policies,
    )
    drive(np.random.default_rng(4), both, NUM_STEPS)
    assert_same(*both)
    assert (both[0].follower_actions != 0.0).any()


def test_snapshots_move_between_the_devices():
    here, there = make_both("interactive")
    rng = np.random.default_rng(5)
    drive(rng, [here, there], 100)
    from_here, from_there = here.snapshot(), there.snapshot()
    here.restore(from_there)
    there.restore(from_here)
    assert there.snapshot() == from_here
    drive(rng, [here, there], 100)
    assert_same(here, there)


def pickled(simulator):
    return pickle.loads(pickle.dumps(simulator))  # noqa: S301 - our own bytes


@pytest.mark.parametrize("copied", [copy.deepcopy, pickled])
def test_a_copy_goes_on_alike_and_separately(copied):
    first = make("interactive", "cuda")
    rng = np.random.default_rng(6)
    drive(rng, [first], 50)
    second = copied(first)
    assert second.snapshot() == first.snapshot()
    drive(rng, [first, second], 50)
    assert second.snapshot() == first.snapshot()
    drive(rng, [first], 1)
    assert second.snapshot() != first.snapshot()


def test_the_same_bytes_again_and_with_other_roads_beside():
    many, few = make("dense", "cuda"), make("dense", "cuda", num_envs=8)
    rng = np.random.default_rng(7)
    for _ in range(200):
        actions = draw(rng, many)
        many.step(actions)
        few.step(actions[:8])
    assert many.vehicles[:8].tobytes() == few.vehicles.tobytes()
    again = make("dense", "cuda")
    assert again.seed(5) is None
    drive(np.random.default_rng(7), [again], 200)
    assert again.initial_seed == many.initial_seed == 5


def test_only_the_time_depends_on_the_team():
    states = []
    for size in (1, 2, 4, 8, 16, 32):
        simulator = Simulator("yielding", NUM_ROADS, seed=5, device="cuda")
        simulator.gpu_roads.form_teams(size)
        simulator.reset()
        drive(np.random.default_rng(9), [simulator], NUM_STEPS // 4)
        states.append(simulator.state.tobytes())
    assert len(set(states)) == 1


def test_waiting_for_a_live_agent():
    both = make_both("paper", num_envs=4)
    for simulator in both:
        simulator.advance_until_live()
    assert_same(*both)
    assert both[1].is_live.any(axis=1).all()


def test_what_is_read_is_a_copy_that_cannot_be_written_to():
    simulator = make("paper", "cuda", num_envs=2)
    before = simulator.roads
    simulator.step()
    assert (simulator.roads["step"] == before["step"] + 1).all()
    for array in (simulator.vehicles, simulator.actions, simulator.state.order):
        with pytest.raises(ValueError, match="read-only"):
            array[...] = array[...]


def test_actions_on_the_gpu_and_one_that_is_not_finite():
    torch = pytest.importorskip("torch")
    here, there = make_both("interactive")
    rng = np.random.default_rng(8)
    for _ in range(20):
        actions = draw(rng, here).astype(np.float32)
        here.step(actions)
        there.step(torch.as_tensor(actions, device="cuda"))
    assert_same(here, there)
    slots = np.argwhere(here.is_acting)
    env, slot = slots[0].tolist()
    idle = np.argwhere(~here.is_acting)[0]
    actions[tuple(idle)] = np.nan
    here.step(actions)
    there.step(torch.as_tensor(actions, device="cuda"))
    assert_same(here, there)
    env, slot = np.argwhere(here.is_acting)[0].tolist()
    actions[env, slot, 0] = np.inf
    there.step(torch.as_tensor(actions, device="cuda"))
    message = rf"actions\[{env}, {slot}, 0\]: must be a finite acceleration"
    with pytest.raises(ValueError, match=message):
        there.snapshot()
    assert_same(here, there)
    there.step(torch.as_tensor(actions, device="cuda"))
    torch.cuda.synchronize()
    with pytest.raises(ValueError, match=message):
        there.step()
    there.step()
    here.step()
    assert_same(here, there)
    with pytest.raises(ValueError, match=r"actions: shape \(1,\), must be"):
        there.step(torch.zeros(1, device="cuda"))
    with pytest.raises(ValueError, match="must not be of type"):
        there.step(torch.zeros(actions.shape, dtype=torch.bool, device="cuda"))


def test_a_thread_takes_little_local_memory():
    from marl_lanes.traffic.gpu_kernels import advance

    make("paper", "cuda", num_envs=1)
    (size,) = advance.get_local_mem_per_thread().values()
    assert size <= 512


def test_no_more_roads_than_fit():
    with pytest.raises(ValueError, match=r"num_envs = \d+: needs about .* GiB of memory of cuda:0"):
        Simulator("paper", 10**9, device="cuda")
    with pytest.raises(ValueError, match=r"device = cuda:99: must be cpu here: there is no GPU 99"):
        Simulator("paper", device="cuda:99")
