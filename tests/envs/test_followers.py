"""Followers as agents, in both environments: the libraries' own tests, pairing, masks, files."""

import subprocess
import sys

import numpy as np
import pytest
import torch
from pettingzoo.test import api_test, parallel_api_test, parallel_seed_test, seed_test
from tensordict import TensorDict

from marl_lanes import LaneChangeEnv, env, load_scenario, parallel_env
from marl_lanes.envs.followers import find_policies
from marl_lanes.naf.checkpoint import CheckpointError
from marl_lanes.traffic.machine.state import Phase
from marl_lanes.traffic.roles.external import FOLLOWER_COLUMNS
from marl_lanes.traffic.roles.follower import FOLLOWER
from marl_lanes.training.checkpoint import make_network, save_checkpoint

torch.set_num_threads(1)

LONG = 100_000
FEW = {"num_agents": 4, "departures": {"interval": [1.5, 3.0]}, "command": {"probability": 1.0}}
MIXED = {**FEW, "followers": {"mix": {"learned": 1.0, "neutral": 1.0}}}
TERMS = [
    f"reward_{name}" for name in ("delay", "abort", "collision", "discomfort", "braking")
]  # fmt: skip


def learners(scenario="paper", render_mode=None, *, seed=0, **options):
    return parallel_env(scenario, render_mode, seed=seed, learned_followers=True, **options)


def learners_in_turn(scenario="paper", render_mode=None, *, seed=0, **options):
    return env(scenario, render_mode, seed=seed, learned_followers=True, **options)


def act(name, observation):
    """A changer's yaw acceleration, a follower's acceleration; one formula for both forms."""
    if name.startswith("follower"):
        gap = float(observation[FOLLOWER_COLUMNS["gap"]])
        return np.array([-1.0 if gap < 20.0 else 2.0], np.float32)
    speed, _, deviation, yaw, yaw_rate, curvature = observation.tolist()
    wanted = min(max(0.5 * deviation, -2.0), 2.0) / max(speed, 1.0)
    return np.array([2.0 * (wanted - yaw) - 2.0 * (yaw_rate - curvature * speed)], np.float32)


def actions_of(road, observations):
    return {name: act(name, observations[name]) for name in road.agents}


def transcript(road, change=lambda actions, _: actions, **reset):
    """Every byte that an episode returns, state() included."""
    observations, infos = road.reset(**reset)
    lines = [repr(infos)]
    while road.agents:
        lines += [f"{name}:{seen.tobytes().hex()}" for name, seen in observations.items()]
        lines.append(road.state().tobytes().hex())
        observations, *others = road.step(change(actions_of(road, observations), infos))
        infos = others[-1]
        lines.append(repr(others))
    return lines


def until_paired(road, seed=0):
    observations, infos = road.reset(seed=seed)
    while not any(info.get("is_paired") for info in infos.values()):
        observations, _, _, _, infos = road.step(actions_of(road, observations))
    return observations, infos


@pytest.mark.filterwarnings("ignore:Agents have different (observation|action) space sizes")
@pytest.mark.filterwarnings("ignore:Observations are different shapes")
@pytest.mark.parametrize("scenario", ["paper", "dense"])
def test_it_passes_pettingzoos_tests(scenario):
    parallel_api_test(learners(scenario), num_cycles=LONG)
    api_test(learners_in_turn(scenario), num_cycles=500)


def test_it_passes_pettingzoos_seed_tests():
    parallel_seed_test(learners)
    seed_test(learners_in_turn)


@pytest.mark.parametrize("num_envs", [1, 3])
@pytest.mark.parametrize("scenario", ["paper", "dense", "five_lanes"])
def test_it_passes_torchrls_spec_check(scenario, num_envs):
    from torchrl.envs.utils import check_env_specs

    roads = LaneChangeEnv(scenario, num_envs, learned_followers=True, seed=0)
    check_env_specs(roads)
    slots = roads.scenario.num_slots
    assert list(roads.group_map) == ["changers", "followers"]
    assert roads.action_spec["followers", "action"].shape == (num_envs, slots, 1)
    shape = (num_envs, slots, len(FOLLOWER.features))
    assert roads.observation_spec["followers", "observation"].shape == shape
    assert roads.action_spec["followers", "action"].space.low.unique().item() == -3.0
    assert roads.action_spec["followers", "action"].space.high.unique().item() == 3.0


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:PettingZoo in TorchRL is tested using version:UserWarning")
def test_it_runs_in_torchrls_wrapper():
    from torchrl.envs import PettingZooWrapper
    from torchrl.envs.utils import check_env_specs

    road = learners(population="constant", overrides={**FEW, "num_agents": 3})
    wrapped = PettingZooWrapper(road, done_on_any=False)
    check_env_specs(wrapped)
    steps = wrapped.rollout(LONG)
    assert road.agents == []
    live = {group: steps[group, "info", "is_live"] for group in ("changer", "follower")}
    assert live["follower"].any(0).all()
    assert torch.equal(live["follower"], live["changer"])
    assert steps["follower", "observation"].shape[1:] == (3, len(FOLLOWER.features) + 3)


@pytest.mark.parametrize("scenario", ["paper", "dense"])
def test_a_seed_gives_the_same_bytes(scenario):
    used = learners(scenario, seed=9, overrides=FEW)
    transcript(used)
    first = transcript(learners(scenario, overrides=FEW), seed=3)
    assert first == transcript(used, seed=3)
    assert first == transcript(learners(scenario, seed=3, overrides=FEW))
    assert first != transcript(used, seed=4)


@pytest.mark.parametrize("overrides", [FEW, MIXED], ids=["learned", "mixed"])
def test_both_environments_give_the_same_road(overrides):
    single = learners("dense", overrides=overrides)
    roads = LaneChangeEnv("dense", 3, overrides=overrides, learned_followers=True, seed=0)
    roads.set_seed(7)
    observations, _ = single.reset(seed=7)
    current = roads.reset()
    simulator, num_paired = roads.simulator, 0

    def advance(current):
        actions = {}
        for group, key in roads.group_map.items():
            action = torch.zeros(3, len(key), 1)
            for road, slot in current[group, "mask"].nonzero().tolist():
                seen = current[group, "observation"][road, slot].numpy()
                action[road, slot, 0] = float(act(group, seen)[0])
            actions[group] = {"action": action}
        return roads.step(TensorDict(actions, roads.batch_size))["next"]

    while single.agents:
        while int(simulator.roads["step"][0]) < int(single.simulator.roads["step"][0]):
            current = advance(current)
        assert simulator.vehicles[0].tobytes() == single.simulator.vehicles[0].tobytes()
        assert simulator.state.followers[0].tobytes() == (
            single.simulator.state.followers[0].tobytes()
        )
        for slot in current["followers", "mask"][0].nonzero()[:, 0].tolist():
            name = f"follower_{simulator.agents['command'][0, slot]}"
            seen = current["followers", "observation"][0, slot].numpy()
            assert seen.tobytes() == observations[name].tobytes()
        observations, rewards, terminations, truncations, infos = single.step(
            actions_of(single, observations)
        )
        step = int(simulator.roads["step"][0]) + 1
        current = advance(current)
        if int(single.simulator.roads["step"][0]) != step:
            continue
        for slot in np.flatnonzero(simulator.agents["vehicle"][0] >= 0):
            name = f"follower_{simulator.agents['command'][0, slot]}"
            if name not in rewards:
                continue
            group = current["followers"][0, slot]
            assert group["reward"].item() == np.float32(rewards[name])
            assert group["terminated"].item() == terminations[name]
            assert group["truncated"].item() == truncations[name]
            assert group["acting"].item() == infos[name]["is_paired"]
            num_paired += int(infos[name]["is_paired"])
    assert num_paired > 20


@pytest.mark.parametrize("overrides", [FEW, MIXED], ids=["learned", "mixed"])
def test_an_unpaired_followers_action_has_no_effect(overrides):
    rng, num_changed = np.random.default_rng(0), 0

    def scramble(actions, infos):
        nonlocal num_changed
        changed = dict(actions)
        for name in actions:
            if name.startswith("follower") and not infos[name]["is_paired"]:
                changed[name] = rng.uniform(-3.0, 3.0, 1).astype(np.float32)
                num_changed += 1
        return changed

    first = transcript(learners("dense", overrides=overrides), seed=2)
    assert first == transcript(learners("dense", overrides=overrides), scramble, seed=2)
    assert num_changed > 20


def test_a_paired_followers_action_moves_its_vehicle_alone():
    road, twin = (learners("dense", overrides=FEW) for _ in range(2))
    observations, infos = until_paired(road)
    until_paired(twin)
    (name,) = [agent for agent, info in infos.items() if info.get("is_paired")]
    slot = road._reader.slots[name]
    vehicle = int(road.simulator.state.followers[0, slot]["vehicle"])
    actions = actions_of(road, observations)
    rewards = road.step({**actions, name: np.array([-3.0], np.float32)})[1]
    others = twin.step({**actions, name: np.array([-1.0], np.float32)})[1]
    cars, same = road.simulator.vehicles[0], twin.simulator.vehicles[0]
    differ = [row for row in range(len(cars)) if cars[row] != same[row]]
    assert differ == [vehicle]
    assert (cars[vehicle]["acceleration"], same[vehicle]["acceleration"]) == (-3.0, -1.0)
    assert rewards[name] < others[name]


def test_followers_are_live_as_long_as_their_changers_and_act_while_paired():
    road = learners("dense", overrides={**MIXED, "num_agents": 20})
    observations, infos = road.reset(seed=1)
    paired, engaged_alone, paid = 0, 0, set()
    while road.agents:
        changers = [name.partition("_")[2] for name in road.agents if name.startswith("changer")]
        assert road.agents == [f"changer_{k}" for k in changers] + [
            f"follower_{k}" for k in changers
        ]
        before = infos
        observations, rewards, terminations, truncations, infos = road.step(
            actions_of(road, observations)
        )
        assert set(observations) == set(rewards) == set(infos) == set(truncations)
        for k in [name.partition("_")[2] for name in infos if name.startswith("changer")]:
            follower, changer = f"follower_{k}", f"changer_{k}"
            info = infos[follower]
            assert terminations[follower] == terminations[changer]
            assert truncations[follower] == truncations[changer]
            assert rewards[follower] == pytest.approx(sum(info[term] for term in TERMS))
            assert road.observation_space(follower).contains(observations[follower])
            if info["is_paired"]:
                assert info["phase"] == Phase.ENGAGED
                paired += 1
            elif info["phase"] == Phase.ENGAGED:
                engaged_alone += 1
            if follower in before and before[follower]["is_paired"]:
                paid |= {term for term in TERMS if info[term]}
            else:
                assert rewards[follower] == 0.0
    # Half of the drivers are neutral: their changers' followers are live but never act.
    assert paired > 100
    assert engaged_alone > 100
    assert {"reward_delay", "reward_discomfort"} <= paid


def test_the_masks_of_a_mix_of_learned_and_scripted_drivers():
    roads = LaneChangeEnv(
        "dense", 4, overrides={**MIXED, "num_agents": 8}, learned_followers=True, seed=0
    )
    assert roads.scenario.followers.mix == {"learned": 1.0, "neutral": 1.0}
    steps = roads.rollout(600, break_when_any_done=False)
    changers, followers = steps["changers"], steps["followers"]
    acting = followers["acting"]
    assert (followers["mask"] == changers["mask"]).all()
    assert not (acting & ~changers["steering"]).any()
    assert 0.1 < acting.sum() / changers["steering"].sum() < 0.9
    assert (changers["acting"] == changers["steering"]).all()
    reward = steps["next", "followers", "reward"].squeeze(-1)
    assert not reward[~acting].any()
    assert reward[acting].all()
    assert (steps["next", "followers", "done"] == steps["next", "changers", "done"]).all()
    scripted = LaneChangeEnv("dense", 4, overrides={"followers": {"mix": {"neutral": 1.0}}}, seed=0)
    assert list(scripted.group_map) == ["changers"]
    whole = LaneChangeEnv("dense", 4, learned_followers=True, seed=0)
    assert whole.scenario.followers.mix == {"learned": 1.0}


def driven_by(path):
    return {
        "followers": {
            "mix": {"learned": 1.0},
            "learned": {"checkpoint": str(path)},
            "external": {"is_guarded": False},
        }
    }


def saved(path, network):
    save_checkpoint(path, network, "paper", 0)
    return driven_by(path)


def test_a_saved_follower_drives(tmp_path):
    torch.manual_seed(1)
    network = make_network(load_scenario("dense"), "mlp", role=FOLLOWER)
    overrides = {**FEW, **saved(tmp_path / "follower.pt", network)}
    scenario = load_scenario("dense", overrides)
    policy = find_policies(scenario)["learned"]
    road = parallel_env(scenario, seed=0)
    state, wanted, found = road.simulator.state, [], []
    observations, _ = road.reset(seed=0)
    assert road.possible_agents == [f"changer_{k}" for k in range(4)]
    while road.agents:
        rows = np.flatnonzero(state.followers[0]["vehicle"] >= 0)
        cars, seen = state.followers[0, rows]["vehicle"], state.follower_observations[0, rows]
        step = int(road.simulator.roads["step"][0])
        asked = policy(seen.copy()).tolist() if rows.size else []
        observations = road.step(actions_of(road, observations))[0]
        # Without live agents it advances further, and the step's accelerations are lost.
        if int(road.simulator.roads["step"][0]) == step + 1:
            wanted += asked
            found += road.simulator.vehicles[0, cars]["acceleration"].tolist()
    assert len(found) > 20
    assert found == wanted
    assert len(set(found)) > 10
    # With a learner the file is not read.
    (tmp_path / "follower.pt").unlink()
    learners(scenario)
    with pytest.raises(CheckpointError, match=r"follower\.pt"):
        parallel_env(scenario)


@pytest.mark.parametrize("form", [parallel_env, LaneChangeEnv])
def test_a_follower_of_the_zoo_is_one_line(small_zoo, form):
    seen = np.random.default_rng(0).normal(size=(5, len(FOLLOWER.features))).astype(np.float32)
    asked = [
        find_policies(load_scenario("paper", driven_by(path)))["learned"](seen).tolist()
        for path in ("zoo:adversary", small_zoo / "adversary.pt")
    ]
    assert asked[0] == asked[1]
    assert len(set(asked[0])) == 5
    form("paper", overrides=driven_by("zoo:adversary"))
    with pytest.raises(CheckpointError, match=r"zoo:absent: no such policy.*zoo:adversary"):
        form("paper", overrides=driven_by("zoo:absent"))


@pytest.mark.parametrize("form", [parallel_env, LaneChangeEnv])
def test_a_checkpoint_of_another_kind_is_refused_by_its_name(tmp_path, form):
    paper = load_scenario("paper")
    path = tmp_path / "changer.pt"
    overrides = saved(path, make_network(paper, "damped"))
    with pytest.raises(CheckpointError, match=r"changer\.pt: its features are \['speed', 'accele"):
        form("paper", overrides=overrides)
    weak = load_scenario("paper", {"followers": {"external": {"max_braking": 2.0}}})
    overrides = saved(tmp_path / "weak.pt", make_network(weak, "mlp", role=FOLLOWER))
    with pytest.raises(CheckpointError, match=r"weak\.pt: its action bounds are .*\[-2\.0\].*-3"):
        form("paper", overrides=overrides)
    path.write_bytes(b"no checkpoint")
    with pytest.raises(CheckpointError, match=r"changer\.pt"):
        form("paper", overrides=driven_by(path))


def test_followers_without_a_checkpoint_need_no_torch():
    script = """
import sys
import numpy as np
from marl_lanes import parallel_env, register_follower

register_follower("mine", lambda seen: np.zeros(len(seen)))
for mix, learned in ({"adversarial": 1.0}, False), ({"mine": 1.0}, False), ({"learned": 1.0}, True):
    road = parallel_env(overrides={"followers": {"mix": mix}}, learned_followers=learned)
    road.reset(seed=0)
    road.step({name: np.zeros(1, np.float32) for name in road.agents})
assert "torch" not in sys.modules, "torch"
"""
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", script], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
