import numpy as np
import pytest
from pictures import STRAIGHT, crop, find_bodies, is_colour, make_frame

from marl_lanes import load_scenario
from marl_lanes.rendering.camera import Camera
from marl_lanes.rendering.layout import make_layout
from marl_lanes.rendering.lettering import Lettering
from marl_lanes.rendering.loading import pygame
from marl_lanes.rendering.options import ViewOptions
from marl_lanes.rendering.palette import CHANGER, GRID, MARKING, VEHICLE, mix
from marl_lanes.rendering.spotlight import Focus
from marl_lanes.rendering.strips import Strips

NOBODY = Focus(-1, None, 0.0, 0)


def paint(*cars, scenario=STRAIGHT, focus=NOBODY, position=0.0):
    layout = make_layout(scenario, ViewOptions())
    lettering, camera = Lettering(), Camera(scenario, layout.camera.size, 140.0)
    camera.look_at(position)
    strips = Strips(scenario, layout)
    surface = pygame.Surface((1280, 720), depth=32)
    strips.draw_ground(surface, lettering)
    strips.draw(surface, make_frame(*cars, scenario=scenario), focus, camera)
    return layout, lettering, pygame.surfarray.array3d(surface).swapaxes(0, 1)


def test_every_vehicle_is_in_its_strip_at_its_place():
    places = [(10.0, 0), (320.0, 2), (340.0, 1), (660.0, 0), (990.0, 2)]
    layout, _, picture = paint(*({"position": place, "lane": lane} for place, lane in places))
    found = find_bodies(picture, VEHICLE)
    assert len(found) == len(places)
    for place, lane in places:
        (strip,) = (one for one in layout.strips if one.start <= place < one.end)
        scale = strip.rect.width / (strip.end - strip.start)
        x = strip.rect.left + scale * (place - strip.start)
        y = strip.rect.bottom - (lane + 0.5) * strip.rect.height / 3
        assert any((x, y) == pytest.approx(middle, abs=1.5) for middle in found)


def test_commanded_vehicles_are_red_and_turned_ones_turned():
    _, _, picture = paint(
        {"position": 100.0, "lane": 1, "phase": 2, "command": 0, "direction": 1, "yaw": 0.1},
        {"position": 200.0, "lane": 1},
    )
    (yellow,) = find_bodies(picture, VEHICLE)
    red = find_bodies(picture, CHANGER)
    # Its windows divide it.
    assert 1 <= len(red) <= 3
    assert all(x < yellow[0] - 300.0 for x, _ in red)
    rows, columns = np.nonzero(is_colour(picture, CHANGER, 60))
    assert np.corrcoef(columns, -rows)[0, 1] > 0.2


def test_the_window_of_the_camera_is_marked():
    layout, _, picture = paint(position=500.0)
    (strip,) = (one for one in layout.strips if one.start <= 500.0 < one.end)
    frame = is_colour(crop(picture, strip.rect.inflate(4, 4)), mix(GRID, MARKING, 0.55), 2)
    columns = frame[strip.rect.height // 2].nonzero()[0]
    scale = strip.rect.width / (strip.end - strip.start)
    assert (columns[-1] - columns[0]) / scale == pytest.approx(140.0, abs=2.0)


def test_the_followed_vehicle_is_pointed_at():
    car = {"position": 100.0, "lane": 1}
    _, _, without = paint(car)
    layout, _, picture = paint(car, focus=Focus(0, 0, 100.0, 1))
    rect = layout.strips[0].rect
    rows, columns = (picture != without).any(axis=2).nonzero()
    assert rows.max() > rect.bottom
    scale = rect.width / (layout.strips[0].end - layout.strips[0].start)
    assert columns.mean() == pytest.approx(rect.left + 100.0 * scale, abs=3.0)


@pytest.mark.parametrize(("length", "label"), [(100.0, "50 m"), (1e5, "20 km"), (1000.0, "100 m")])
def test_positions_are_labelled(length, label):
    road = {"length": length}
    scenario = load_scenario({"name": "road", "road": road, "command": {"position": [40, 50]}})
    layout, lettering, _ = paint(scenario=scenario)
    assert label in lettering.texts
    assert len(lettering.texts) > 3
    for box in lettering.placed:
        assert not any(box.colliderect(strip.rect) for strip in layout.strips)


def test_a_picture_without_strips_has_none():
    layout = make_layout(STRAIGHT, ViewOptions(size=(320, 180)))
    surface, camera = pygame.Surface((320, 180), depth=32), Camera(STRAIGHT, (320, 180), 140.0)
    strips = Strips(STRAIGHT, layout)
    strips.draw_ground(surface, Lettering())
    strips.draw(surface, make_frame({"position": 10.0}), NOBODY, camera)
    assert not pygame.surfarray.array3d(surface).any()


def test_a_truck_at_the_end_of_a_strip_is_in_both():
    strip, following = make_layout(STRAIGHT, ViewOptions()).strips[:2]
    _, _, picture = paint({"position": strip.end + 3.0, "lane": 1, "profile": 3})
    rows, columns = is_colour(picture, VEHICLE, 60).nonzero()
    scale = strip.rect.width / (strip.end - strip.start)
    shown = {"first": (strip, 8.25 - 3.0), "second": (following, 8.25 + 3.0)}
    widths = {}
    for name, (one, _) in shown.items():
        own = columns[(rows >= one.rect.top) & (rows < one.rect.bottom)]
        assert one.rect.left <= own.min() <= own.max() < one.rect.right
        widths[name] = np.ptp(own) + 1
    wanted = {name: scale * metres for name, (_, metres) in shown.items()}
    assert widths == pytest.approx(wanted, abs=2.5)


def test_trucks_are_longer_in_the_strips():
    _, _, picture = paint(
        {"position": 100.0, "lane": 0}, {"position": 300.0, "lane": 0, "profile": 3}
    )
    columns = is_colour(picture, VEHICLE, 60).any(axis=0).nonzero()[0]
    car, truck = np.split(columns, np.flatnonzero(np.diff(columns) > 100) + 1)
    assert np.ptp(truck) + 1 > 2.5 * (np.ptp(car) + 1)
