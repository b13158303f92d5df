"""Seeds: a given one repeats the traffic; without one, copies differ and tell what they drew."""

import copy
import pickle

import pytest
import torch
from tensordict.nn import TensorDictModule
from torchrl.envs import EnvCreator, ParallelEnv, SerialEnv

from marl_lanes import LaneChangeEnv, Simulator, env, parallel_env

torch.set_num_threads(1)

QUICK = {"command": {"probability": 1.0}, "warmup": [30.0, 30.0]}


def make():
    return LaneChangeEnv("paper", 2, overrides=QUICK)


class Same:
    """A function that always returns the same environment."""

    def __init__(self, roads):
        self.roads = roads

    def __call__(self):
        return self.roads


def traffic(road):
    """Bytes of the roads after a reset."""
    road.reset()
    return road.unwrapped.simulator.vehicles.tobytes()


def made(form, seed=None):
    if form is Simulator:
        road = Simulator("paper", 2, seed=seed, overrides=QUICK)
        road.unwrapped = type("Itself", (), {"simulator": road, "initial_seed": road.initial_seed})
        return road
    if form is LaneChangeEnv:
        road = LaneChangeEnv("paper", 2, seed=seed, overrides=QUICK)
        road.unwrapped = road
        return road
    return form("paper", seed=seed, overrides=QUICK)


FORMS = [Simulator, LaneChangeEnv, parallel_env, env]


@pytest.mark.parametrize("form", FORMS)
def test_without_a_seed_each_is_another_and_its_seed_repeats_it(form):
    roads = [made(form) for _ in range(3)]
    seeds = [road.unwrapped.initial_seed for road in roads]
    assert len(set(seeds)) == 3
    assert all(0 <= seed < 2**63 for seed in seeds)
    seen = [traffic(road) for road in roads]
    assert len(set(seen)) == 3
    assert [traffic(made(form, seed)) for seed in seeds] == seen


@pytest.mark.parametrize("form", FORMS)
def test_a_seed_repeats_the_traffic_and_a_reset_goes_on(form):
    one, other = made(form, 5), made(form, 5)
    first, second = traffic(one), traffic(one)
    assert first != second
    assert [traffic(other), traffic(other)] == [first, second]


def test_to_set_no_seed_draws_one():
    roads = make()
    roads.set_seed(3)
    assert roads.initial_seed == 3
    seeds = {roads.set_seed(None) or roads.initial_seed for _ in range(3)}
    assert len(seeds - {3}) == 3
    roads.simulator.seed()
    assert roads.initial_seed not in seeds
    single = parallel_env(seed=3)
    single.reset(seed=None)
    assert single.initial_seed == 3


DUPLICATE = pytest.mark.parametrize(
    "duplicate",
    [copy.deepcopy, lambda one: pickle.loads(pickle.dumps(one))],  # noqa: S301
)


@DUPLICATE
@pytest.mark.parametrize("form", FORMS[1:])
def test_a_copy_goes_on_with_the_same_random_numbers(form, duplicate):
    road = form("paper", overrides=QUICK)
    road.reset()
    twin = duplicate(road)
    roads = [getattr(one, "unwrapped", one) if form in FORMS[2:] else one for one in (road, twin)]
    assert roads[0].initial_seed == roads[1].initial_seed
    road.reset()
    assert roads[0].simulator.snapshot() != roads[1].simulator.snapshot()
    twin.reset()
    assert roads[0].simulator.snapshot() == roads[1].simulator.snapshot()


@DUPLICATE
@pytest.mark.parametrize("form", FORMS[1:])
def test_a_copy_draws_its_own_seed_if_none_was_given_and_nothing_has_happened(form, duplicate):
    road = made(form)
    seeds = {duplicate(road).unwrapped.initial_seed for _ in range(2)}
    assert len(seeds | {road.unwrapped.initial_seed}) == 3
    assert duplicate(made(form, 5)).unwrapped.initial_seed == 5


def test_a_batch_that_was_seeded_or_restored_is_copied_as_it_is():
    roads = make()
    roads.set_seed(3)
    assert copy.deepcopy(roads).initial_seed == 3
    other = make()
    other.restore(roads.simulator.snapshot())
    assert copy.deepcopy(other).simulator.snapshot() == roads.simulator.snapshot()
    roads.set_seed(None)
    assert copy.deepcopy(roads).initial_seed != roads.initial_seed


def test_the_generator_for_wrappers_belongs_to_the_present_seed():
    def first_number(road):
        return road.np_random.bit_generator.state

    road = parallel_env(overrides=QUICK)
    other = parallel_env(seed=1, overrides=QUICK)
    first_number(road)
    twin = copy.deepcopy(road)
    expected = parallel_env(seed=twin.initial_seed)
    assert first_number(twin) == first_number(expected)
    other.reset()
    road.reset(options={"snapshot": other.simulator.snapshot()})
    assert road.initial_seed == 1
    assert first_number(road) == first_number(parallel_env(seed=1))
    cycle = env(seed=1)
    assert first_number(cycle) == first_number(parallel_env(seed=1))


@pytest.mark.parametrize("seed", [None, 7])
def test_serial_copies_differ(seed):
    roads = SerialEnv(2, make)
    if seed is not None:
        roads.set_seed(seed)
    seen = roads.rollout(80, break_when_any_done=False)["changers", "observation"]
    assert seen.any()
    assert (seen[0] != seen[1]).any()
    roads.close()


@pytest.mark.training
@pytest.mark.parametrize(
    "wrap", [lambda function: function, EnvCreator, lambda function: Same(function())]
)
def test_the_copies_of_workers_differ(wrap):
    roads = ParallelEnv(2, wrap(make), mp_start_method="fork")
    seen = roads.rollout(80, break_when_any_done=False)["changers", "observation"]
    assert seen.any()
    assert (seen[0] != seen[1]).any()
    roads.close()


@pytest.mark.long
@pytest.mark.filterwarnings(
    "ignore:Creating .* which inherits from WeightUpdaterBase:DeprecationWarning"
)
def test_the_batches_of_collectors_differ():
    from torchrl.collectors import MultiCollector

    policy = TensorDictModule(
        lambda seen: torch.zeros_like(seen[..., :1]),
        [("changers", "observation")],
        [("changers", "action")],
    )
    collector = MultiCollector(
        [make, make],
        policy,
        frames_per_batch=2 * 2 * 80,
        total_frames=2 * 2 * 80,
        sync=True,
        cat_results="stack",
    )
    (batch,) = collector
    collector.shutdown()
    seen = batch["changers", "observation"]
    assert seen.any()
    assert (seen[0] != seen[1]).any()
