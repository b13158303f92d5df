"""render_mode of PettingZoo's environment: pictures, a window, and the run that they leave."""

import copy
import pickle
import subprocess
import sys
import warnings
from functools import partial

import numpy as np
import pygame
import pytest
import torch
from envs.playing import BUSY, steer
from envs.showing import RED, SMALL, assert_shows_traffic, is_near

from marl_lanes import env, load_scenario, parallel_env
from marl_lanes.rendering.options import ViewOptions
from marl_lanes.rendering.painter import Painter
from marl_lanes.rendering.window import DisplayError
from marl_lanes.traffic.machine.state import Fate, Outcome

with warnings.catch_warnings():
    # With pygame installed, PettingZoo's tests import one of its games in a deprecated way.
    warnings.filterwarnings("ignore", "The old environment creation API", DeprecationWarning)
    from pettingzoo.test.render_test import render_test

torch.set_num_threads(1)


def swerve(_):
    return np.array([0.5], np.float32)


def drive(road, steps=None, policy=steer, **reset):
    """The bytes after reset and after every step; a step more is a picture more, if there is one.

    Args:
        road: a parallel environment.
        steps: at most so many; None: the episode.
        policy: from the observation of an agent to its action.
        reset: arguments of reset.
    """
    observations, infos = road.reset(**reset)
    lines = [repr((observations, infos))]
    while road.agents and len(lines) != steps:
        lines.append(road.simulator.snapshot())
        actions = {agent: policy(observations[agent]) for agent in road.agents}
        observations, *others = road.step(actions)
        lines[-1] += repr((observations, others)).encode()
        if road.render_mode == "rgb_array":
            road.render()
    lines.append(road.simulator.snapshot())
    return lines


@pytest.fixture
def screenless(monkeypatch):
    """Windows that nobody sees, as SDL's driver for tests has them."""
    pygame.display.quit()
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    yield
    pygame.display.quit()


@pytest.mark.usefixtures("screenless")
def test_it_passes_pettingzoos_render_test():
    render_test(partial(env, view=SMALL))


@pytest.mark.usefixtures("screenless")
@pytest.mark.parametrize("mode", ["rgb_array", "human"])
def test_the_parallel_form_renders_as_the_aec_form(mode):
    with_cycle, road = (form("paper", mode, view=SMALL) for form in (env, parallel_env))
    assert road.metadata["render_modes"] == with_cycle.metadata["render_modes"]
    assert mode in road.metadata["render_modes"]
    with_cycle.reset(seed=0)
    road.reset(seed=0)
    for _ in range(5):
        pictures = [form.render() for form in (with_cycle, road)]
        if mode == "human":
            assert pictures == [None, None]
        else:
            assert np.array_equal(*pictures)
        road.step({agent: swerve(None) for agent in road.agents})
        for _ in list(with_cycle.agents):
            with_cycle.step(swerve(None))
    for form in (with_cycle, road):
        form.close()
        form.close()


@pytest.mark.usefixtures("no_window")
@pytest.mark.parametrize("size", [(320, 180), (1280, 720)])
def test_an_array_is_the_picture_of_the_state_until_the_next_step(size):
    road = parallel_env("dense", "rgb_array", view={"size": size}, seed=0)
    road.reset(seed=0)
    pictures = []
    for _ in range(3):
        first = road.render()
        assert first.shape == (size[1], size[0], 3)
        assert first.dtype == np.uint8
        assert_shows_traffic(first)
        pictures.append(first.copy())
        first.fill(0)
        assert np.array_equal(road.render(), pictures[-1])
        road.step({agent: swerve(None) for agent in road.agents})
    assert not np.array_equal(pictures[0], pictures[1])
    assert not np.array_equal(pictures[1], pictures[2])


def test_a_seed_gives_the_same_pictures_in_any_episode():
    def film(road):
        observations, _ = road.reset(seed=3)
        pictures = [road.render()]
        while len(pictures) < 40:
            actions = {agent: steer(observations[agent]) for agent in road.agents}
            observations = road.step(actions)[0]
            pictures.append(road.render())
        return np.stack(pictures)

    used, fresh = (parallel_env("dense", "rgb_array", view=SMALL, seed=0) for _ in range(2))
    drive(used, steps=5, seed=4)
    first = film(used)
    assert np.array_equal(film(used), first)
    assert np.array_equal(film(fresh), first)


def test_a_lane_change_is_seen():
    road = parallel_env("paper", "rgb_array", view=ViewOptions(follow="changer_0"), seed=0)
    painter = Painter(road.scenario)
    scale = painter.layout.camera.width / painter.options.span
    observations, infos = road.reset(seed=0)
    rows = []
    while "changer_0" in road.agents:
        seen = is_near(road.render()[painter.layout.camera.top : painter.layout.camera.bottom], RED)
        assert seen.sum() > 100
        rows.append(np.flatnonzero(seen.any(axis=1)).mean())
        actions = {agent: steer(observations[agent]) for agent in road.agents}
        observations, *_, infos = road.step(actions)
    assert infos["changer_0"]["outcome"] == Outcome.COMPLETED
    assert abs(rows[-1] - rows[0]) == pytest.approx(road.scenario.road.lane_width * scale, abs=5.0)


@pytest.mark.usefixtures("screenless")
@pytest.mark.parametrize(
    ("scenario", "options"),
    [
        ("paper", {"overrides": {"num_agents": 3}}),
        ("interactive", {"overrides": {"num_agents": 4, "horizon": 8.0}}),
        (
            "dense",
            {
                "overrides": {"num_agents": 2, "followers": {"mix": {"own": 1.0}}},
                "follower_policies": {"own": lambda seen: 0.1 * seen[:, 0] - 1.0},
            },
        ),
    ],
)
def test_the_run_has_the_same_bytes_whether_it_is_shown_or_not(scenario, options):
    unseen = drive(parallel_env(scenario, **options), seed=5)
    for mode in ("rgb_array", "human"):
        assert drive(parallel_env(scenario, mode, view=SMALL, **options), seed=5) == unseen


@pytest.mark.usefixtures("screenless")
def test_a_window_shows_every_step_once_also_those_without_an_agent(frames):
    road = parallel_env("paper", "human", view=SMALL, overrides={"num_agents": 2}, seed=0)
    num_steps = len(drive(road, seed=0))
    last = int(road.simulator.roads["step"][0])
    assert [frame.step for frame in frames] == list(range(last + 1))
    assert last + 1 > num_steps + 20
    outcomes = [frame.rows["outcome"].max() for frame in frames]
    assert np.count_nonzero(outcomes) == 2


def test_a_picture_shows_what_the_step_has_removed_and_the_actions(frames):
    road = parallel_env(
        "dense", "rgb_array", view=SMALL, overrides={**BUSY, "num_agents": 12}, seed=0
    )
    road.reset(seed=0)
    lost = acted = 0
    while road.agents:
        before = int(road.simulator.roads["step"][0])
        infos = road.step({agent: swerve(None) for agent in road.agents})[4]
        road.render()
        if int(road.simulator.roads["step"][0]) > before + 1:
            continue
        rows = frames[-1].rows
        ended = {name for name, info in infos.items() if info["outcome"] != Outcome.UNFINISHED}
        named = rows["command"][rows["outcome"] != Outcome.UNFINISHED]
        assert {f"changer_{command}" for command in named.tolist()} == ended
        lost += np.isin(rows["fate"], (Fate.STRAYS, Fate.COLLIDES)).any()
        acted += (rows["action_yaw_acceleration"] == 0.5).any()
    assert lost > 3
    assert acted > 20


def test_without_a_mode_render_warns_and_nothing_is_imported():
    road = parallel_env(seed=0)
    road.reset(seed=0)
    with pytest.warns(UserWarning, match="without specifying any render mode"):
        assert road.render() is None
    road.close()
    program = (
        "import sys, marl_lanes; road = marl_lanes.parallel_env('paper', view={'span': 90.0});"
        "road.reset(seed=0); road.step({name: [0.0] for name in road.agents});"
        "print([name for name in sys.modules if name.startswith(('pygame', 'pyarrow', "
        "'marl_lanes.rendering', 'marl_lanes.trajectory', 'marl_lanes.envs.rendering'))])"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    assert done.stdout == "[]\n"


def test_the_metadata_has_the_modes_and_the_steps_in_a_second():
    kind = type(parallel_env(seed=0))
    assert kind.metadata["render_modes"] == ["human", "rgb_array"]
    assert kind.metadata["render_fps"] == 1.0 / load_scenario("paper").time_step
    for form in (env, parallel_env):
        fast = form("paper", overrides={"time_step": 0.05})
        assert fast.metadata == {**kind.metadata, "render_fps": 20.0}
    assert kind.metadata["render_fps"] == 10.0


@pytest.mark.parametrize("form", [parallel_env, env])
def test_other_modes_and_views_are_refused(form):
    for mode in ("ansi", "", True, "RGB_ARRAY"):
        with pytest.raises(ValueError, match=rf"render_mode = {mode!r}: must be None or one of"):
            form("paper", mode)
    with pytest.raises(ValueError, match=r"size = \(10, 10\): must be"):
        form("paper", "rgb_array", view={"size": (10, 10)})
    with pytest.raises(ValueError, match="zoom: is no option of a view"):
        form("paper", "human", view={"zoom": 2.0})


@pytest.mark.usefixtures("no_window")
@pytest.mark.parametrize("can_begin", [False, True])
def test_a_window_without_a_display_is_one_error_that_changes_nothing(monkeypatch, can_begin):
    def fail(*_):
        raise pygame.error("no screen")

    if can_begin:
        # As Windows does where nobody is logged in.
        monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
        monkeypatch.setattr(pygame, "Window", fail)
    elif sys.platform != "linux":
        pytest.skip("there is always a display")
    road = parallel_env("paper", "human", view=SMALL, seed=0)
    before = road.simulator.snapshot()
    with pytest.raises(DisplayError, match="render_mode = 'human': no display for a window"):
        road.reset(seed=0)
    assert road.simulator.snapshot() == before


@pytest.mark.usefixtures("screenless")
@pytest.mark.parametrize(
    "duplicate",
    [copy.deepcopy, lambda road: pickle.loads(pickle.dumps(road))],  # noqa: S301
)
def test_copies_go_on_with_their_own_road(duplicate):
    road = parallel_env("dense", "rgb_array", view=SMALL, seed=0)
    road.reset(seed=0)
    for _ in range(5):
        road.step({agent: swerve(None) for agent in road.agents})
    picture = road.render()
    twin = duplicate(road)
    road.step({agent: swerve(None) for agent in road.agents})
    assert np.array_equal(twin.render(), picture)
    twin.step({agent: swerve(None) for agent in twin.agents})
    assert np.array_equal(twin.render(), road.render())
    shown = parallel_env("dense", "human", view=SMALL, seed=0)
    fresh = duplicate(shown)
    shown.reset(seed=0)
    unseen = duplicate(shown)
    for one, is_open in ((shown, True), (unseen, False), (fresh, True)):
        one.reset(seed=0)
        one.step({agent: swerve(None) for agent in one.agents})
        assert one._renderer.is_open == is_open
        one.close()
        assert not one._renderer.is_open


@pytest.mark.usefixtures("screenless")
@pytest.mark.parametrize("way", ["close", "cross", "escape"])
def test_after_the_window_is_closed_the_run_goes_on_unshown(frames, way):
    road = parallel_env("paper", "human", view=SMALL, overrides={"num_agents": 2}, seed=0)
    unseen = drive(parallel_env("paper", overrides={"num_agents": 2}, seed=0), seed=0)

    shown = []

    def close(observation):
        if not shown:
            shown.append(len(frames))
            window = road._renderer._window._window
            if way == "close":
                road.close()
            elif way == "cross":
                pygame.event.post(pygame.event.Event(pygame.WINDOWCLOSE, window=window))
            else:
                press = {"key": pygame.K_ESCAPE, "unicode": "\x1b", "window": window}
                pygame.event.post(pygame.event.Event(pygame.KEYDOWN, press))
        return steer(observation)

    assert drive(road, policy=close, seed=0) == unseen
    assert shown[0] > 20
    assert len(frames) == shown[0] + (way != "close")
    assert road.render() is None
    assert drive(road, seed=0) == unseen
    assert len(frames) == shown[0] + (way != "close")
