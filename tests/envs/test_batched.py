"""The TorchRL environment: specs, seeds, resets, collectors, copies, devices."""

import copy
import pickle

import pytest
import torch
from envs.rolling import BUSY, SHORT, assert_equal, hold, roll, steer
from forking import exit_code_of_child
from tensordict import TensorDict
from torchrl.envs.utils import check_env_specs

from marl_lanes import LaneChangeEnv, ScenarioError

torch.set_num_threads(1)

PLAIN = {"track_traj_ids": False, "auto_register_policy_transforms": False}
"""A collector without trajectory ids: agents end, and slots get new agents, within a road."""

collector_warnings = pytest.mark.filterwarnings(
    "ignore:Creating .* which inherits from WeightUpdaterBase:DeprecationWarning"
)


def road_bytes(env, road):
    return [array[road].tobytes() for array in env.simulator.state.arrays]


@pytest.mark.parametrize("num_envs", [1, 4])
@pytest.mark.parametrize("scenario", ["paper", "dense", "curved", "five_lanes", "touch"])
def test_it_passes_torchrls_spec_check(scenario, num_envs):
    env = LaneChangeEnv(scenario, num_envs, seed=0)
    check_env_specs(env)
    check_env_specs(env, break_when_any_done="both")
    num_slots = env.scenario.num_slots
    assert env.batch_size == (num_envs,)
    assert env.group_map == {"changers": [f"changer_{slot}" for slot in range(num_slots)]}
    assert env.action_spec["changers", "action"].shape == (num_envs, num_slots, 1)
    assert env.observation_spec["changers", "observation"].shape == (num_envs, num_slots, 6)
    assert env.device == torch.device("cpu")


@pytest.mark.slow
@pytest.mark.parametrize("module", [steer, hold], ids=["steer", "hold"])
def test_a_seed_gives_the_same_rollout(module):
    used, fresh = LaneChangeEnv("dense", 2, seed=8), LaneChangeEnv("dense", 2, seed=3)
    first = roll(fresh, 300, module)
    roll(used, 500)
    used.set_seed(3)
    again = roll(used, 300, module)
    assert first["next", "changers", "mask"].any()
    assert_equal(first, again)
    used.set_seed(4)
    assert not (roll(used, 300)["changers", "mask"] == first["changers", "mask"]).all()
    following = roll(fresh, 300, module)
    assert not (following["changers", "mask"] == first["changers", "mask"]).all()


def test_roads_differ_and_do_not_depend_on_their_number():
    few, many = LaneChangeEnv("paper", 2, seed=3), LaneChangeEnv("paper", 5, seed=3)
    steps = roll(many, 300)
    assert_equal(roll(few, 300), steps[:2])
    masks = steps["changers", "mask"].flatten(1)
    assert len(torch.unique(masks, dim=0)) == 5


def test_a_partial_reset_leaves_the_other_roads_alone():
    env, twin = (LaneChangeEnv("dense", 3, overrides={"num_slots": 4}, seed=0) for _ in range(2))
    last, same = (roll(one, 60)[:, -1]["next"] for one in (env, twin))
    before = [road_bytes(env, road) for road in range(3)]
    assert last["changers", "mask"].any(1).all()
    asked = same.exclude(("changers", "reward"))
    asked["_reset"] = torch.tensor([[False], [True], [False]])
    after = env.reset(asked)
    assert [road_bytes(env, road) == before[road] for road in range(3)] == [True, False, True]
    kept = torch.tensor([0, 2])
    for key in ("observation", "mask", "steering", "command_reward", "outcome"):
        assert torch.equal(after["changers", key][kept], last["changers", key][kept])
    assert env.simulator.roads["step"].tolist() == [60, 0, 60]
    assert not after["changers", "outcome"][1].any()
    assert not after["changers", "command_reward"][1].any()
    # The other roads continue like those of an equal environment without the reset.
    ahead = env.rollout(100, steer, auto_reset=False, tensordict=after, break_when_any_done=False)
    there = twin.rollout(
        100,
        steer,
        auto_reset=False,
        tensordict=same.exclude(("changers", "reward"), "_reset"),
        break_when_any_done=False,
    )
    assert_equal(ahead["next"][kept], there["next"][kept])
    assert ahead["next", "changers", "mask"][kept].any()
    assert env.simulator.roads["step"].tolist() == [160, 100, 160]


def test_a_reset_of_every_road_and_of_none():
    env = LaneChangeEnv("paper", 2, seed=0)
    roll(env, 20)
    state = env.simulator.state.tobytes()
    assert env.simulator.roads["step"].tolist() == [20, 20]
    env.simulator.reset([False, False])
    assert env.simulator.state.tobytes() == state
    env.reset(TensorDict({"_reset": torch.ones(2, 1, dtype=torch.bool)}, [2]))
    assert env.simulator.roads["step"].tolist() == [0, 0]
    with pytest.raises(ValueError, match="mask: shape"):
        env.simulator.reset([True])


def test_a_collector_resets_each_road_at_its_end():
    from torchrl.collectors import Collector

    env = LaneChangeEnv("paper", 3, overrides=SHORT, seed=0)
    collector = Collector(env, steer, frames_per_batch=600, total_frames=3000, **PLAIN)
    steps = torch.cat([batch.clone() for batch in collector], 1)
    collector.shutdown()
    assert steps.shape == (3, 1000)
    done = steps["next", "done"].squeeze(-1)
    mask, after = steps["changers", "mask"], steps["next", "changers", "mask"]
    assert done.sum(1).min() >= 2
    ends = steps["next", "changers", "done"].squeeze(-1).cumsum(1).sum(2)
    assert torch.equal(ends[done] % 2, torch.zeros_like(ends[done]))
    assert torch.isin(ends[:, -1] - 2 * done.sum(1), torch.tensor([0, 1])).all()
    # After an end the road starts again; the others continue.
    assert (steps["next", "changers", "outcome"][done] > 0).any(1).all()
    assert not steps["changers", "outcome"][:, 1:][done[:, :-1]].any()
    assert torch.equal(mask[:, 1:][~done[:, :-1]], after[:, :-1][~done[:, :-1]])
    assert not (done.all(0)).any()


@collector_warnings
def test_a_collector_runs_roads_without_end():
    from torchrl.collectors import Collector

    env = LaneChangeEnv("paper", 2, overrides=BUSY, seed=5)
    expected = roll(env, 400)
    env.set_seed(5)
    collector = Collector(env, steer, frames_per_batch=200, total_frames=800, **PLAIN)
    steps = torch.cat([batch.clone() for batch in collector], 1)
    collector.shutdown()
    assert not steps["next", "done"].any()
    assert steps["next", "changers", "done"].any()
    for key in ("observation", "reward", "mask", "outcome"):
        assert torch.equal(steps["next", "changers", key], expected["next", "changers", key])


def test_returned_tensors_are_nobody_elses():
    env, twin = (LaneChangeEnv("paper", 2, overrides=BUSY, seed=0) for _ in range(2))
    current, same = env.reset(), twin.reset()
    frames, copies = [], []
    for _ in range(150):
        frames.append(env.step(steer(current))["next"])
        copies.append(frames[-1].clone())
        current = frames[-1].select(*env.observation_spec.keys(True, True)).clone()
    assert copies[-1]["changers", "mask"].any()
    for frame, saved in zip(frames, copies, strict=True):
        assert_equal(frame, saved)
    # Overwriting the returned tensors changes neither the road nor later frames.
    for saved in copies:
        after = twin.step(steer(same))["next"]
        assert_equal(after, saved)
        same = after.select(*env.observation_spec.keys(True, True)).clone()
        for leaf in after.values(True, True):
            leaf.fill_(1)


@pytest.mark.parametrize("duplicate", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])  # noqa: S301
def test_a_copy_goes_on_by_itself(duplicate):
    env = LaneChangeEnv("paper", 2, overrides=BUSY, seed=0)
    last = roll(env, 150)[:, -1]["next"].exclude(("changers", "reward"))
    twin = duplicate(env)
    frozen = env.simulator.state.tobytes()

    def go_on(one):
        return roll(one, 80, auto_reset=False, tensordict=last.clone())

    ahead = go_on(twin)
    assert env.simulator.state.tobytes() == frozen
    assert_equal(ahead, go_on(env))
    assert ahead["next", "changers", "steering"].any()


def test_what_cannot_be_is_refused():
    with pytest.raises(ScenarioError, match="scenario 'nowhere': no such scenario"):
        LaneChangeEnv("nowhere")
    with pytest.raises(ScenarioError, match=r"followers\.mix: 'rude' has no policy; allowed: "):
        LaneChangeEnv(overrides={"followers": {"mix": {"rude": 1.0}}})
    with pytest.raises(ScenarioError, match="num_slots = 0"):
        LaneChangeEnv(overrides={"num_slots": 0})
    with pytest.raises(ValueError, match="num_envs = 0"):
        LaneChangeEnv(num_envs=0)
    with pytest.raises(ValueError, match="seed = -1"):
        LaneChangeEnv(seed=-1)


def test_actions_are_clipped_and_must_be_numbers_where_an_agent_steers():
    env, twin = (LaneChangeEnv("paper", 1, overrides=BUSY, seed=0) for _ in range(2))

    def step(one, action):
        return one.step(TensorDict({"changers": {"action": action}}, [1]))["next"]

    env.reset()
    twin.reset()
    steering = torch.zeros(1, 3, 1, dtype=torch.bool)
    while not steering.any() or steering.all():
        steering = step(env, torch.zeros(1, 3, 1))["changers", "steering"].unsqueeze(-1)
        step(twin, torch.zeros(1, 3, 1))
    after = step(env, torch.where(steering, 9.0, float("nan")))
    assert_equal(after, step(twin, torch.where(steering, 0.5, -0.5)))
    with pytest.raises(ValueError, match=r"actions\[0, \d, 0\] = nan: must be a finite"):
        step(env, torch.where(steering, float("nan"), 0.0))


def test_tensors_are_made_where_the_environment_is(monkeypatch):
    env = LaneChangeEnv("paper", 2, seed=0)
    # The specs cannot be made on this device.
    monkeypatch.setattr(LaneChangeEnv, "device", torch.device("meta"))
    elsewhere = env._reset()
    assert elsewhere.device == elsewhere["changers"].device == torch.device("meta")
    assert all(value.device.type == "meta" for value in elsewhere.values(True, True))


def test_torchrl_checks_the_types_where_it_is_asked_to(monkeypatch):
    env = LaneChangeEnv("paper", 2, seed=0)
    env.run_type_checks = True
    assert env.rollout(2).shape == (2, 2)
    read_out = env._read_out

    def read_out_wrongly():
        groups = read_out()
        groups["changers"]["reward"] = groups["changers"]["reward"].astype("f8")
        return groups

    monkeypatch.setattr(env, "_read_out", read_out_wrongly)
    with pytest.raises(TypeError, match="dtype"):
        env.rollout(2)


def test_the_device_may_be_left_open():
    env = LaneChangeEnv("paper", 1, device=None, seed=0)
    assert env.rollout(2).device is None
    assert LaneChangeEnv("paper", 1, device="cpu", seed=0).rollout(2).device == torch.device("cpu")


@pytest.mark.parametrize("learned_followers", [False, True])
@pytest.mark.parametrize(
    ("dtype", "device"),
    [(torch.float64, "cpu"), (torch.bfloat16, "cpu"), (torch.float32, "meta")],
)
def test_torchs_defaults_change_nothing(dtype, device, learned_followers):
    def rollout():
        env = LaneChangeEnv("paper", 2, seed=1, overrides=BUSY, learned_followers=learned_followers)
        check_env_specs(env)
        env.set_seed(1)
        return roll(env, 60, hold) if not learned_followers else env.rollout(3)

    expected = rollout()
    torch.set_default_dtype(dtype)
    try:
        with torch.device(device):
            found = rollout()
    finally:
        torch.set_default_dtype(torch.float32)
    leaves = {key: leaf.dtype for key, leaf in expected.items(True, True)}
    assert {key: leaf.dtype for key, leaf in found.items(True, True)} == leaves
    assert found.device == torch.device("cpu")
    if not learned_followers:
        assert_equal(found, expected)


@pytest.mark.filterwarnings("ignore:.*multi-threaded.*fork:DeprecationWarning")
def test_it_works_in_a_forked_process():
    """With so many roads torch would use its threads, which are gone there."""
    env = LaneChangeEnv("paper", 2048, seed=0, num_threads=2, overrides={"warmup": [1.0, 1.0]})
    torch.set_num_threads(2)
    try:
        env.rollout(2)
        assert exit_code_of_child(lambda: env.rollout(2).shape == (2048, 2)) == 0
    finally:
        torch.set_num_threads(1)
