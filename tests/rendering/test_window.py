"""The window: its keys, its pace, its events, and a screen on which it is seen."""

import os
import shutil
import subprocess
from types import SimpleNamespace

import numpy as np
import pygame
import pytest
from imageio_ffmpeg import get_ffmpeg_exe

from marl_lanes import Simulator
from marl_lanes.rendering.options import ViewOptions
from marl_lanes.rendering.painter import Painter
from marl_lanes.rendering.window import SPEEDS, DisplayError, Window
from marl_lanes.trajectory.frames import FrameReader

FAST = ViewOptions(size=(640, 360), speed=64.0)
XVFB = shutil.which("Xvfb")


@pytest.fixture
def screenless(no_display, monkeypatch):  # noqa: ARG001
    """Windows that nobody sees, as SDL's driver for tests has them."""
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")


@pytest.fixture
def screen(no_display, monkeypatch):  # noqa: ARG001
    """A screen in memory; gives its name."""
    if XVFB is None:
        pytest.skip("needs Xvfb, a screen in memory (Debian: apt-get install xvfb)")
    read, write = os.pipe()
    command = [XVFB, "-displayfd", str(write), "-screen", "0", "1000x600x24"]
    server = subprocess.Popen(command, pass_fds=[write], stderr=subprocess.DEVNULL)
    os.close(write)
    with os.fdopen(read) as file:
        display = f":{file.readline().strip()}"
    monkeypatch.setenv("DISPLAY", display)
    yield display
    pygame.display.quit()
    server.terminate()
    server.wait()


def make_frame(scenario="dense"):
    simulator = Simulator(scenario, seed=0)
    simulator.reset()
    simulator.advance_until_live()
    (frame,) = FrameReader(simulator).read_frames()
    return frame


FRAME = make_frame()


def open_window(options=FAST):
    """A window that has shown the frame, and its painter."""
    window, painter = Window(FRAME.scenario, options), Painter(FRAME.scenario, options)
    window.show(painter, FRAME)
    return window, painter


def press(window, *keys):
    """Each a letter, or the number of a key without one."""
    for key in keys:
        code, letter = (key, "") if isinstance(key, int) else (ord(key), key)
        owner = window._window
        event = pygame.event.Event(pygame.KEYDOWN, key=code, unicode=letter, window=owner)
        pygame.event.post(event)


def contents(window):
    return pygame.surfarray.array3d(window._window.get_surface()).swapaxes(0, 1)


@pytest.mark.usefixtures("screenless")
def test_it_shows_the_picture_above_the_bar():
    window, _ = open_window()
    picture = Painter(FRAME.scenario, FAST).draw(FRAME)
    assert np.array_equal(contents(window)[:360], picture)
    bar = contents(window)[360:]
    assert bar.shape[0] >= 20
    assert bar.std() > 5.0
    press(window, " ", "s")
    window.close()
    assert not window.is_open
    window.close()
    window.attend()


@pytest.mark.usefixtures("screenless")
@pytest.mark.parametrize("size", [(320, 180), (1280, 720)])
def test_the_bar_names_keys_that_fit_it(size):
    window, _ = open_window(ViewOptions(size=size, speed=64.0))
    texts, places = window._lettering.texts, window._lettering.placed
    assert texts[0] == "64x"
    assert texts[1] == "space: pause"
    assert all(window._bar.contains(place) for place in places)
    assert all(not place.collidelistall(places[:k]) for k, place in enumerate(places))
    assert len(texts) == 8 if size == (1280, 720) else len(texts) >= 3


@pytest.fixture
def clock(monkeypatch):
    """Time passes only where the window waits, and where the test says so; [now] in seconds."""
    now = [100.0]

    def wait(timeout):
        now[0] += 0.001 * timeout
        return pygame.event.Event(pygame.NOEVENT)

    monkeypatch.setattr(pygame.event, "wait", wait)
    monkeypatch.setattr(
        "marl_lanes.rendering.window.time", SimpleNamespace(perf_counter=lambda: now[0])
    )
    return now


@pytest.mark.usefixtures("screenless")
def test_a_step_is_shown_for_its_time(clock):
    window, painter = open_window(ViewOptions(size=(320, 180), speed=2.0))
    assert clock[0] == pytest.approx(100.05, abs=0.001)
    for _ in range(20):
        clock[0] += 0.03
        window.show(painter, FRAME)
    assert clock[0] == pytest.approx(101.05, abs=0.002)
    # A slow policy is not slowed down, and the time that it loses is not made up.
    clock[0] += 0.4
    window.show(painter, FRAME)
    assert clock[0] == pytest.approx(101.45, abs=0.002)
    window.show(painter, FRAME)
    assert clock[0] == pytest.approx(101.50, abs=0.002)


@pytest.mark.usefixtures("screenless")
def test_the_keys_set_the_speed():
    window, _ = open_window(ViewOptions(size=(320, 180), speed=16.0))
    press(window, "+", "=", "-")
    window.attend()
    assert window._speed == 32.0
    assert window._lettering.texts[0] == "32x"
    press(window, *"+" * 20)
    window.attend()
    assert window._speed == SPEEDS[1]
    press(window, *"-" * 20)
    window.attend()
    assert window._speed == SPEEDS[0]


@pytest.mark.usefixtures("screenless")
def test_space_holds_the_run_and_a_full_stop_lets_one_step_pass(monkeypatch):
    window, painter = open_window()
    waits = []
    wait = pygame.event.wait

    def script(timeout):
        """Nothing for three waits, then one step; later nothing, then on."""
        waits.append(timeout)
        if len(waits) == 3:
            press(window, ".")
        if len(waits) == 8:
            press(window, " ")
        return wait(timeout)

    monkeypatch.setattr(pygame.event, "wait", script)
    press(window, " ")
    window.show(painter, FRAME)
    assert len(waits) == 3
    assert window._lettering.texts[0] == "64x, paused"
    window.show(painter, FRAME)
    assert len(waits) >= 8
    assert window._lettering.texts[0] == "64x"
    count = len(waits)
    window.show(painter, FRAME)
    assert len(waits) - count <= 2


@pytest.mark.usefixtures("screenless")
def test_the_arrows_follow_the_next_vehicle_and_a_an_agent():
    window, painter = open_window()
    order = FRAME.rows["vehicle"][np.argsort(FRAME.rows["position"])].tolist()
    agent = painter.followed
    rank = order.index(agent)
    before = contents(window).copy()
    press(window, pygame.K_RIGHT)
    window.attend()
    assert painter.followed == order[rank + 1]
    assert not np.array_equal(contents(window), before)
    press(window, pygame.K_LEFT, pygame.K_LEFT)
    window.attend()
    assert painter.followed == order[rank - 1]
    press(window, "a")
    window.attend()
    assert painter.followed == agent
    press(window, *[pygame.K_RIGHT] * len(order))
    window.attend()
    assert painter.followed == agent
    assert np.array_equal(contents(window)[:360], before[:360])
    painter.forget()
    painter.draw(FRAME)
    assert painter.followed == agent


@pytest.mark.usefixtures("screenless")
def test_a_click_follows_the_vehicle_at_its_place():
    window, painter = open_window()

    def click(x, y):
        place = {"pos": (int(x), int(y)), "button": 1, "window": window._window}
        pygame.event.post(pygame.event.Event(pygame.MOUSEBUTTONDOWN, place))
        window.attend()

    camera, strip = painter.layout.camera, painter.layout.strips[0].rect
    for view, find in ((camera, np.argmax), (strip, np.argmax), (strip, np.argmin)):
        picture = contents(window)[view.top : view.bottom].astype(int)
        red, green, blue = np.moveaxis(picture, -1, 0)
        rows, columns = np.nonzero(np.minimum(red, green) - blue > 60)
        before, pixel = painter.followed, find(columns)
        click(columns[pixel], rows[pixel] + view.top)
        assert painter.followed != before
        assert FRAME.rows["phase"][FRAME.rows["vehicle"] == painter.followed] == [0]
    before = painter.followed
    click(2, 2)
    click(10, 365)
    assert painter.followed == before


@pytest.mark.usefixtures("screenless")
def test_s_saves_the_picture_under_a_free_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    window, painter = open_window()
    for _ in range(2):
        press(window, "s")
        window.attend()
    names = [f"dense-{FRAME.step:06d}.png", f"dense-{FRAME.step:06d}-2.png"]
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(names)
    assert window._lettering.texts[0] == f"saved {names[1]}, 64x"
    for name in names:
        saved = pygame.surfarray.array3d(pygame.image.load(tmp_path / name)).swapaxes(0, 1)
        assert np.array_equal(saved, painter.draw(FRAME))
    monkeypatch.setattr("marl_lanes.rendering.window.write_atomically", refuse)
    press(window, "s")
    window.attend()
    assert window._lettering.texts[0] == "not saved: No space left on device, 64x"
    assert len(list(tmp_path.iterdir())) == 2


def refuse(*_):
    raise OSError(28, "No space left on device")


@pytest.mark.usefixtures("screenless")
def test_each_window_has_its_own_events():
    first, painter = open_window()
    second, _ = open_window()
    press(second, "+")
    press(first, "-", pygame.K_ESCAPE)
    second.attend()
    assert (first.is_open, second.is_open) == (False, True)
    assert first._speed == 32.0
    first.show(painter, FRAME)
    third, _ = open_window()
    pygame.event.post(pygame.event.Event(pygame.QUIT))
    third.attend()
    assert not second.is_open
    assert not third.is_open


@pytest.mark.usefixtures("no_display")
@pytest.mark.parametrize("driver", [None, "nonsense"])
def test_without_a_display_there_is_one_clear_error(monkeypatch, driver):
    if driver is not None:
        monkeypatch.setenv("SDL_VIDEODRIVER", driver)
    with pytest.raises(DisplayError, match=r"no display for a window .*; use 'rgb_array' here"):
        Window(FRAME.scenario, FAST)
    assert not pygame.display.get_init()


@pytest.mark.slow
def test_it_is_seen_on_a_screen(screen):
    window, painter = open_window()
    assert pygame.display.get_driver() == "x11"
    for _ in range(30):
        window.show(painter, FRAME)
    left, top = window._window.position
    width, height = window._window.size
    command = [get_ffmpeg_exe(), "-loglevel", "error", "-f", "x11grab", "-draw_mouse", "0"]
    command += ["-video_size", f"{width}x{height}", "-i", f"{screen}+{left},{top}"]
    command += ["-frames:v", "1", "-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    done = subprocess.run(command, capture_output=True, check=True)
    seen = np.frombuffer(done.stdout, np.uint8).reshape(height, width, 3)
    assert np.array_equal(seen[:360], painter.draw(FRAME))
    window.close()
