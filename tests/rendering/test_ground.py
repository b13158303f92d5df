import numpy as np
import pytest
from pictures import LEFT_BEND, STRAIGHT, count_colours, is_colour

from marl_lanes.rendering.camera import Camera
from marl_lanes.rendering.ground import DASH_LENGTH, DASH_PERIOD, Gap, Ground
from marl_lanes.rendering.loading import pygame
from marl_lanes.rendering.palette import GROUND, MARKING, REFUSED_GAP, ROAD, SAFE_GAP, mix

WIDTH = 3.75


def paint(scenario, position, target_lane=None, gap=None, size=(1280, 300), span=128.0):
    camera = Camera(scenario, size, span)
    camera.look_at(position)
    surface = pygame.Surface(size, depth=32)
    Ground(scenario, camera).draw(surface, target_lane, gap)
    return camera, pygame.surfarray.array3d(surface).swapaxes(0, 1)


def colour_at(camera, picture, position, lateral):
    x, y, _ = camera.place(position, lateral)
    return tuple(picture[int(y), int(x)].tolist())


@pytest.mark.parametrize("scenario", [STRAIGHT, LEFT_BEND], ids=lambda one: one.name)
def test_markings_stand_still_on_the_road(scenario):
    for position in (500.0, 503.7, 517.2):
        camera, picture = paint(scenario, position)
        for number in range(27, 30):
            dash = number * DASH_PERIOD
            for lane in (1, 2):
                for offset, colour in (
                    (0.0, MARKING),
                    (0.4 * DASH_LENGTH, MARKING),
                    (-0.4 * DASH_LENGTH, MARKING),
                    (0.6 * DASH_LENGTH, ROAD),
                    (0.5 * DASH_PERIOD, ROAD),
                ):
                    found = colour_at(camera, picture, dash + offset, lane * WIDTH)
                    # A thin line may cover two pixels in part.
                    assert (np.mean(found) > 110) == (colour == MARKING), (number, offset)
            for lateral in (-0.15, 3 * WIDTH + 0.15):
                assert np.mean(colour_at(camera, picture, dash, lateral)) > 200
            for lane in range(3):
                assert colour_at(camera, picture, dash, (lane + 0.5) * WIDTH) == ROAD
            for lateral in (-6.0, 3 * WIDTH + 6.0):
                near = np.subtract(colour_at(camera, picture, dash, lateral), GROUND)
                assert np.abs(near).max() <= 8


def test_there_is_no_road_beyond_its_ends():
    for position, inside, outside in ((10.0, 2.0, -2.0), (990.0, 998.0, 1002.0)):
        camera, picture = paint(STRAIGHT, position)
        assert colour_at(camera, picture, inside, 2.0) == ROAD
        assert colour_at(camera, picture, outside, 2.0) == GROUND


def test_the_target_lane_is_dotted_in_its_middle():
    camera, picture = paint(STRAIGHT, 500.0, target_lane=2)
    _, y, _ = camera.place(500.0, 2.5 * WIDTH)
    bright = picture[int(y) - 1 : int(y) + 2].mean(axis=2).max(axis=0) > 100
    dots = np.flatnonzero(np.diff(bright.astype(int)) == 1).size
    assert dots == pytest.approx(128.0 / 3.0, abs=2)
    _, other, _ = camera.place(500.0, 0.5 * WIDTH)
    assert (picture[int(other)] == ROAD).all()


@pytest.mark.parametrize("scenario", [STRAIGHT, LEFT_BEND], ids=lambda one: one.name)
def test_an_accepted_gap_is_plain_from_bumper_to_bumper(scenario):
    gap = Gap(0, 480.0, 520.0, SAFE_GAP, is_hatched=False)
    camera, picture = paint(scenario, 500.0, gap=gap)
    band = mix(ROAD, SAFE_GAP, 0.5)
    for position in (481.0, 500.0, 519.0):
        found = colour_at(camera, picture, position, 0.5 * WIDTH)
        assert np.abs(np.subtract(found, band)).max() <= 2
    for position, lateral in ((479.0, 1.9), (521.0, 1.9), (500.0, 1.5 * WIDTH)):
        assert colour_at(camera, picture, position, lateral) == ROAD
    assert np.mean(is_colour(picture, band, 2)) == pytest.approx(
        40.0 * 0.76 * WIDTH * camera.scale**2 / picture[..., 0].size, rel=0.1
    )


def test_a_refused_gap_is_hatched():
    gap = Gap(0, 480.0, 520.0, REFUSED_GAP, is_hatched=True)
    camera, picture = paint(STRAIGHT, 500.0, gap=gap)
    _, y, _ = camera.place(500.0, 0.5 * WIDTH)
    x, _, _ = camera.place([481.0, 519.0], 0.5 * WIDTH)
    line = picture[int(y), int(x[0]) : int(x[1])].mean(axis=1)
    strokes = np.flatnonzero(np.diff((line > line.mean()).astype(int)) == 1).size
    assert strokes == pytest.approx(38.0 / 2.4, abs=2)


def test_distances_are_lines_with_strokes_at_their_ends():
    gap = Gap(0, 480.0, 520.0, SAFE_GAP, is_hatched=False, distances=((480.0, 497.0),))
    camera, picture = paint(STRAIGHT, 500.0, gap=gap)
    bright = picture.min(axis=2) > 190
    x, y, _ = camera.place([480.0, 497.0], 0.5 * WIDTH)
    left, right = int(x[0]), int(x[1])
    line = bright[int(y[0]) - 1 : int(y[0]) + 1].any(axis=0)
    assert line[left + 1 : right - 1].all()
    assert not line[right + 2 : right + 60].any()
    for column in (left, right - 1):
        stroke = bright[int(y[0]) - 12 : int(y[0]) + 12, column - 1 : column + 2].any(axis=1)
        assert stroke.sum() == pytest.approx(0.4 * WIDTH * camera.scale, abs=2)


def test_a_gap_outside_of_the_picture_is_not_drawn():
    gap = Gap(0, 700.0, 750.0, SAFE_GAP, is_hatched=False)
    _, without = paint(STRAIGHT, 500.0)
    _, picture = paint(STRAIGHT, 500.0, gap=gap)
    assert (picture == without).all()


@pytest.mark.parametrize("span", [128.0, 300.0, 600.0])
def test_the_edges_of_a_bend_do_not_waver(span):
    camera, picture = paint(LEFT_BEND, 500.0, span=span)
    beside = 2.0 / camera.scale
    for place in np.arange(453.0, 547.0, 0.5):
        if abs(place - 500.0) < 5.0:
            continue  # A post.
        for middle in (-0.15, 3 * WIDTH + 0.15):
            light = [
                np.mean(colour_at(camera, picture, place, middle + side * (0.15 + beside)))
                for side in (-1, 0, 1)
            ]
            assert light[1] > 110.0 > 70.0 > max(light[0], light[2]), (place, middle)


def test_edges_are_smooth():
    _, picture = paint(LEFT_BEND, 500.0)
    assert count_colours(picture) > 40
