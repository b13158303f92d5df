"""Pictures of the TorchRL environment's roads, and the run that they leave."""

import pickle

import numpy as np
import pytest
import torch
from envs.playing import BUSY
from envs.showing import SMALL, assert_shows_traffic
from tensordict import TensorDict

from marl_lanes import LaneChangeEnv
from marl_lanes.traffic.machine.state import Fate, Outcome

torch.set_num_threads(1)


@pytest.mark.usefixtures("no_window")
def test_a_chosen_road_of_the_torchrl_environment():
    roads = LaneChangeEnv("dense", 3, render_mode="rgb_array", view=SMALL, seed=0)
    alone = LaneChangeEnv("dense", 1, first_road=1, render_mode="rgb_array", view=SMALL, seed=0)
    seen = []
    for one, road in ((roads, 1), (alone, 0)):
        state = one.reset()
        for _ in range(5):
            one.render(road)
            state["changers", "action"] = torch.full(
                (one.simulator.num_envs, one.simulator.num_slots, 1), 0.5
            )
            state = one.step(state)["next"]
        seen.append(one.render(road))
    assert_shows_traffic(seen[0])
    assert np.array_equal(*seen)
    assert not np.array_equal(roads.render(), seen[0])
    assert np.array_equal(roads.render(0), roads.render())
    for road in (-1, 3):
        with pytest.raises(ValueError, match=f"road = {road}: must be 0 to 2"):
            roads.render(road)


def test_the_first_picture_of_an_episode_knows_nothing_of_the_last_one():
    used = LaneChangeEnv("paper", render_mode="rgb_array", view=SMALL, seed=0)
    for seed in range(6):
        fresh = LaneChangeEnv("paper", seed=seed, render_mode="rgb_array", view=SMALL)
        used.set_seed(seed)
        for one in (used, fresh):
            one.reset()
        assert np.array_equal(used.render(), fresh.render())


def test_the_torchrl_environment_shows_what_a_step_has_removed_and_the_actions(frames):
    overrides = {**BUSY, "num_agents": None, "horizon": None}
    roads = LaneChangeEnv(
        "dense", 2, render_mode="rgb_array", view=SMALL, overrides=overrides, seed=0
    )
    state = roads.reset()
    ended = shown = acted = 0
    for _ in range(150):
        roads.render(1)
        state["changers", "action"] = torch.full((2, roads.simulator.num_slots, 1), 0.5)
        state = roads.step(state)["next"]
        ended += int((state["changers", "outcome"][1] == Outcome.OFF_ROAD).sum())
        roads.render(1)
        shown += int((frames[-1].rows["fate"] == Fate.STRAYS).sum())
        acted += int((frames[-1].rows["action_yaw_acceleration"] == 0.5).sum())
    assert shown == ended > 0
    assert acted > 20
    assert [frame.step for frame in frames] == list(range(151))


def test_a_reset_or_a_restored_state_of_a_road_is_seen():
    roads = LaneChangeEnv("paper", 2, render_mode="rgb_array", view=SMALL, seed=0)
    roads.reset()
    start, snapshot = roads.render(1), roads.simulator.snapshot()
    roads.rollout(20, auto_reset=False, tensordict=roads.reset())
    kept, moved = roads.render(0), roads.render(1)
    roads.reset(TensorDict({"_reset": torch.tensor([[False], [True]])}, [2]))
    assert np.array_equal(roads.render(0), kept)
    assert not np.array_equal(roads.render(1), moved)
    roads.restore(snapshot)
    assert np.array_equal(roads.render(1), start)


def test_the_torchrl_environment_has_the_same_bytes_whether_it_is_shown_or_not():
    states = []
    for mode in (None, "rgb_array"):
        roads = LaneChangeEnv("dense", 2, render_mode=mode, view=SMALL, seed=0)
        roads.set_seed(0)
        state = roads.reset()
        for _ in range(30):
            if mode is not None:
                roads.render(1)
            state["changers", "action"] = torch.full((2, roads.simulator.num_slots, 1), 0.3)
            state = roads.step(state)["next"]
        states.append(roads.simulator.snapshot())
    assert states[0] == states[1]


def test_the_torchrl_environment_renders_arrays_alone():
    with pytest.raises(ValueError, match="render_mode = 'human': must be None or 'rgb_array'"):
        LaneChangeEnv(render_mode="human")
    with pytest.raises(ValueError, match="make the environment with render_mode='rgb_array'"):
        LaneChangeEnv().render()


def test_a_copy_of_the_torchrl_environment_renders_its_own_roads():
    roads = LaneChangeEnv("paper", 2, render_mode="rgb_array", view=SMALL, seed=0)
    roads.reset()
    twin = pickle.loads(pickle.dumps(roads))  # noqa: S301
    assert np.array_equal(twin.render(), roads.render())
    twin.rand_step(twin.reset())
    twin.simulator.vehicles["position"] += 50.0
    picture = roads.render()
    roads._find_renderer(0).note()
    assert np.array_equal(roads.render(), picture)
