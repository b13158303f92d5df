from itertools import pairwise

import numpy as np
import pytest
from films import describe, read_pictures

from marl_lanes import load_scenario
from marl_lanes.rendering import film as module
from marl_lanes.rendering.encoding import FilmError
from marl_lanes.rendering.film import Clip, arrange, choose_size, cut, write_film, write_still
from marl_lanes.rendering.options import ViewOptions
from marl_lanes.rendering.painter import Painter
from marl_lanes.traffic.machine.state import NONE, Phase
from marl_lanes.trajectory.columns import new_rows
from marl_lanes.trajectory.frames import Frame

SCENARIO = load_scenario("paper")
SMALL = ViewOptions(size=(640, 360), span=100.0)


def frames(first, last, *, speed=20.0, lane=1):
    """A changer from the middle to the left lane, ahead of another vehicle."""
    found = []
    for step in range(first, last + 1):
        rows = new_rows(2)
        rows["step"], rows["time"] = step, step * SCENARIO.time_step
        rows["vehicle"] = [3, 4]
        along = speed * step * SCENARIO.time_step
        rows["position"] = [200.0 + along, 180.0 + along]
        rows["lateral_position"] = [5.625 + 3.75 * (step - first) / (last - first), 1.875]
        rows["speed"], rows["lane"] = speed, [lane, 0]
        rows["lane_low"] = rows["lane_high"] = rows["lane"]
        rows["command"], rows["phase"] = [0, NONE], [Phase.ENGAGED, Phase.ABSENT]
        rows["direction"], rows["origin_lane"], rows["target_lane"] = [1, 0], 1, 2
        found.append(Frame(SCENARIO, 0, step, rows))
    return found


def red(picture):
    """Where the changer's body is: rows and columns of its pixels."""
    colour = picture.astype(int)
    return np.nonzero(colour[..., 0] > np.maximum(colour[..., 1], colour[..., 2]) + 80)


def write(path, *clips, options=SMALL):
    write_film(path, clips, options)
    return read_pictures(path)


@pytest.mark.parametrize(("suffix", "number"), [(".mp4", 61), (".gif", 26)])
def test_a_film_lasts_as_long_as_its_frames_and_shows_them(tmp_path, suffix, number):
    found = write(tmp_path / f"film{suffix}", Clip("policy", frames(10, 30)))
    assert found.shape == (number, 360, 640, 3)
    # The camera follows along the road, and the changer moves to the left, up.
    before, after = (red(found[index][:200]) for index in (0, -1))
    assert min(before[0].size, after[0].size) > 30
    pixels_per_metre = 640 / 100.0
    assert before[0].mean() - after[0].mean() == pytest.approx(3.75 * pixels_per_metre, abs=2.5)
    assert before[1].mean() == pytest.approx(after[1].mean(), abs=2.0)


def test_the_motion_is_smooth_between_the_steps(tmp_path):
    """Ten steps a second and thirty pictures: none is the one before it."""
    found = write(tmp_path / "film.mp4", Clip("policy", frames(0, 10)))
    drawn = Painter(SCENARIO, SMALL, title="policy").draw(frames(0, 10)[5])
    assert np.abs(found[15].astype(int) - drawn).mean() < 3.0
    moved = [np.abs(after.astype(int) - before).mean() for before, after in pairwise(found)]
    assert min(moved) > 0.05


@pytest.mark.parametrize(("speed", "number"), [(0.5, 121), (2.0, 31)])
def test_the_speed_of_a_film(tmp_path, speed, number):
    options = ViewOptions(size=(320, 180), speed=speed)
    found = write(tmp_path / "film.mp4", Clip("policy", frames(0, 20)), options=options)
    assert len(found) == number


@pytest.mark.slow
def test_roads_side_by_side_have_one_clock_and_the_one_that_ends_stays(tmp_path):
    clips = (Clip("short", frames(0, 5)), Clip("long", frames(5, 20)))
    found = write(tmp_path / "film.mp4", *clips, options=ViewOptions(size=(640, 480)))
    assert found.shape == (61, 480, 640, 3)
    upper, lower = found[:, :240].astype(int), found[:, 240:].astype(int)
    # Only the first one moves until 0.5 s, only the other one after that.
    early, late = slice(2, 14), slice(20, 59)
    assert (
        np.abs(np.diff(upper[early], axis=0)).mean()
        > 10 * np.abs(np.diff(lower[early], axis=0)).mean()
    )
    assert (
        np.abs(np.diff(lower[late], axis=0)).mean()
        > 10 * np.abs(np.diff(upper[late], axis=0)).mean()
    )
    # It is darker, but still there.
    assert 0.3 * upper[2].mean() < upper[-1].mean() < 0.8 * upper[2].mean()
    assert lower[-1].mean() == pytest.approx(lower[2].mean(), rel=0.1)


def test_the_line_above_a_road_has_its_title_and_says_when_it_ends(tmp_path, monkeypatch):
    texts = []

    class Lettering(module.Lettering):
        def put(self, surface, text, *arguments, **options):
            texts.append(text)
            return super().put(surface, text, *arguments, **options)

    monkeypatch.setattr(module, "Lettering", Lettering)
    clips = [Clip("short", frames(0, 5)), Clip("long", frames(0, 10))]
    write_still(tmp_path / "early.png", clips, 0.4, ViewOptions(size=(640, 480)))
    assert texts == ["short", "long"]
    texts.clear()
    write_still(tmp_path / "late.png", clips, 0.8, ViewOptions(size=(640, 480)))
    assert texts == ["ends at 0.5 s", "short", "long"]


def test_every_road_has_its_place(tmp_path):
    clips = [Clip(str(index), frames(0, 3)) for index in range(5)]
    write_still(tmp_path / "still.png", clips, 0.1, ViewOptions(size=(1200, 900), span=100.0))
    (picture,) = read_pictures(tmp_path / "still.png")
    assert picture.shape == (900, 1200, 3)
    for index in range(5):
        row, column = divmod(index, 3)
        own = picture[450 * row : 450 * (row + 1), 400 * column : 400 * (column + 1)]
        assert red(own)[0].size > 30
    assert (picture[450:, 800:] == picture[-1, -1]).all()


def test_a_still_is_the_painters_picture(tmp_path):
    every = frames(0, 20)
    write_still(tmp_path / "still.png", [Clip("policy", every)], 1.2, SMALL)
    (picture,) = read_pictures(tmp_path / "still.png")
    drawn = Painter(SCENARIO, SMALL, title="policy").draw(every[12])
    np.testing.assert_array_equal(picture, drawn)


def test_each_clip_follows_its_own_vehicle(tmp_path):
    clips = [Clip("a", frames(0, 3), 4), Clip("b", frames(0, 3))]
    write_still(tmp_path / "still.png", clips, 0.0, ViewOptions(size=(640, 480), follow=3))
    (picture,) = read_pictures(tmp_path / "still.png")
    upper, lower = red(picture[:150])[1], red(picture[240:390])[1]
    assert upper.mean() - lower.mean() > 50


@pytest.mark.slow
def test_the_same_clips_are_the_same_bytes(tmp_path):
    for name in ("one.mp4", "other.mp4"):
        clips = Clip("a", frames(0, 6)), Clip("b", frames(0, 4))
        write_film(tmp_path / name, clips, ViewOptions(size=(640, 480)))
    assert (tmp_path / "one.mp4").read_bytes() == (tmp_path / "other.mp4").read_bytes()


def test_the_progress_of_a_film(tmp_path):
    counts = []
    options = ViewOptions(size=(320, 180))
    clips = [Clip("a", frames(0, 1))]
    write_film(tmp_path / "film.mp4", clips, options, progress=lambda *one: counts.append(one))
    assert counts == [(1, 4), (2, 4), (3, 4), (4, 4)]


def test_cut_takes_the_time_and_else_the_nearest_frame():
    every = frames(10, 20)
    assert [one.step for one in cut("a", iter(every), 1.1, 1.3).frames] == [11, 12, 13]
    assert [one.step for one in cut("a", every, 3.0, 4.0).frames] == [20]
    assert [one.step for one in cut("a", every, 0.0, 0.5).frames] == [10]
    assert cut("a", every, 1.0, 2.0, 7) == Clip("a", every, 7)


@pytest.mark.parametrize(
    ("number", "wanted"), [(1, (1280, 720)), (2, (1280, 720)), (3, (1280, 960)), (9, (1280, 960))]
)
def test_a_good_size_has_room_for_all(tmp_path, number, wanted):
    size = choose_size(tmp_path / "film.mp4", number)
    assert size == wanted
    columns, (width, height), head = arrange(number, size)
    assert columns * width <= size[0]
    assert -(-number // columns) * (height + head) <= size[1]
    small = choose_size(tmp_path / "film.gif", number)
    assert small[0] < size[0]
    assert arrange(number, small)[0] == columns


@pytest.mark.parametrize(
    ("name", "clips", "options", "message"),
    [
        ("film.png", [Clip("a", frames(0, 1))], SMALL, r"must end in \.mp4 or \.gif"),
        ("film", [Clip("a", frames(0, 1))], SMALL, r"must end in \.mp4 or \.gif"),
        ("film.mp4", [], SMALL, "clips: must have at least one entry"),
        ("film.mp4", [Clip("a", [])], SMALL, "frames: must have at least one frame"),
        (
            "film.mp4",
            [Clip("a", frames(0, 1))] * 3,
            SMALL,
            r"size = \(640, 360\): must be at least 324 x 600 for 3 roads",
        ),
    ],
)
def test_what_cannot_be_filmed_is_refused_and_nothing_is_written(
    tmp_path, name, clips, options, message
):
    with pytest.raises(ValueError, match=message):
        write_film(tmp_path / name, clips, options)
    assert list(tmp_path.iterdir()) == []


def test_a_still_is_a_png(tmp_path):
    with pytest.raises(FilmError, match=r"must end in \.png"):
        write_still(tmp_path / "still.mp4", [Clip("a", frames(0, 1))], 0.0, SMALL)


def test_a_gif_has_a_rate_that_a_gif_can_have(tmp_path):
    write(tmp_path / "film.gif", Clip("a", frames(0, 10)), options=ViewOptions(size=(320, 180)))
    assert "12.50 fps" in describe(tmp_path / "film.gif")
