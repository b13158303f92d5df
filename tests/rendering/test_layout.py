import itertools

import pytest

from marl_lanes import load_scenario
from marl_lanes.rendering.layout import COLUMNS, make_layout
from marl_lanes.rendering.loading import pygame
from marl_lanes.rendering.options import ViewOptions

SIZES = [
    (320, 180),
    (480, 270),
    (640, 360),
    (854, 480),
    (1280, 720),
    (1920, 1080),
    (3840, 2160),
    (320, 2160),
    (720, 1280),
    (3840, 180),
]
ROADS = [(1000.0, 3), (100.0, 2), (100_000.0, 16), (1000.0, 16)]


def scenario_of(length, num_lanes):
    raw = {"name": "road", "road": {"length": length, "num_lanes": num_lanes}}
    raw["command"] = {"position": [40.0, 60.0], "probability": 0.0}
    return load_scenario(raw)


@pytest.mark.parametrize("size", SIZES, ids=str)
@pytest.mark.parametrize("road", ROADS, ids=str)
def test_parts_are_disjoint_and_inside(size, road):
    layout = make_layout(scenario_of(*road), ViewOptions(size=size))
    parts = [layout.camera, *(strip.rect for strip in layout.strips), *layout.panel.values()]
    whole = pygame.Rect((0, 0), size)
    assert all(whole.contains(part) and part.width > 0 and part.height > 0 for part in parts)
    assert not any(one.colliderect(other) for one, other in itertools.combinations(parts, 2))
    assert layout.camera.width == size[0]
    assert layout.camera.height >= 0.29 * size[1]


@pytest.mark.parametrize("road", ROADS, ids=str)
def test_strips_are_the_whole_road_in_reading_order(road):
    layout = make_layout(scenario_of(*road), ViewOptions())
    strips = layout.strips
    assert 1 <= len(strips) <= 6
    assert strips[0].start == 0.0
    assert strips[-1].end == pytest.approx(road[0])
    for above, below in itertools.pairwise(strips):
        assert above.end == below.start
        assert above.rect.bottom < below.rect.top
    assert all(strip.rect.height % road[1] == 0 for strip in strips)


def test_a_long_road_has_several_strips():
    assert len(make_layout(scenario_of(1000.0, 3), ViewOptions()).strips) == 3
    assert len(make_layout(scenario_of(100.0, 3), ViewOptions()).strips) == 1


@pytest.mark.parametrize(
    ("size", "parts"), [((320, 180), 0), ((640, 360), 2), ((1280, 720), 4), ((720, 1280), 4)]
)
def test_small_pictures_drop_parts(size, parts):
    layout = make_layout(scenario_of(1000.0, 3), ViewOptions(size=size))
    assert list(layout.panel) == list(COLUMNS)[:parts]
    if size == (320, 180):
        assert layout.strips == ()
        assert layout.camera == pygame.Rect(0, 0, 320, 180)


def test_text_grows_with_the_picture():
    sizes = [make_layout(scenario_of(1000.0, 3), ViewOptions(size=size)).text for size in SIZES[:7]]
    assert sizes == sorted(sizes)
    assert (sizes[0], sizes[4], sizes[6]) == (11, 14, 42)
