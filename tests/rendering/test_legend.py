import pytest
from pictures import STRAIGHT, find_bodies

from marl_lanes import load_scenario
from marl_lanes.rendering.layout import make_layout
from marl_lanes.rendering.legend import Legend
from marl_lanes.rendering.lettering import Lettering
from marl_lanes.rendering.loading import pygame
from marl_lanes.rendering.options import ViewOptions
from marl_lanes.rendering.palette import CHANGER, REFUSED_GAP, ROAD, SAFE_GAP, VEHICLE, mix

ALWAYS = [
    "Legend",
    "commanded",
    "other vehicle",
    "indicator",
    "braking",
    "collided or lost",
    "gap accepted",
    "gap refused",
    "target lane",
]


def paint(scenario=STRAIGHT, size=(1280, 720)):
    layout, lettering = make_layout(scenario, ViewOptions(size=size)), Lettering()
    surface = pygame.Surface(size, depth=32)
    Legend(scenario, layout, lettering).draw(surface)
    return layout, lettering, pygame.surfarray.array3d(surface).swapaxes(0, 1)


@pytest.mark.parametrize(
    ("mix_of", "more"),
    [
        ({"neutral": 1.0}, []),
        ({"cooperative": 0.5, "adversarial": 0.5}, ["cooperative", "adversarial"]),
        ({"neutral": 0.5, "mine": 0.5}, ["driven by a policy"]),
    ],
)
def test_the_legend_names_what_the_traffic_has(mix_of, more):
    scenario = load_scenario({"name": "mixed", "followers": {"mix": mix_of}})
    layout, lettering, _ = paint(scenario)
    assert lettering.texts == [*ALWAYS[:3], *more, *ALWAYS[3:]]
    assert all(layout.panel["legend"].contains(box) for box in lettering.placed)


def test_the_signs_have_the_colours_of_the_traffic():
    _, _, picture = paint()
    assert find_bodies(picture, CHANGER, 40)
    assert find_bodies(picture, VEHICLE, 40)
    assert len(find_bodies(picture, mix(ROAD, SAFE_GAP, 0.5), 200)) == 1
    assert find_bodies(picture, mix(ROAD, REFUSED_GAP, 0.8), 4)


def test_every_text_is_shown_also_in_large_pictures():
    for size in ((1920, 1080), (3840, 2160), (720, 1280)):
        _, lettering, _ = paint(size=size)
        assert lettering.texts == ALWAYS


def test_small_pictures_have_none():
    _, lettering, picture = paint(size=(640, 360))
    assert lettering.texts == []
    assert not picture.any()
