import itertools

import pytest
from pictures import STRAIGHT, commanded, make_frame

from marl_lanes import load_scenario
from marl_lanes.rendering.camera import Camera
from marl_lanes.rendering.labels import Labels
from marl_lanes.rendering.layout import make_layout
from marl_lanes.rendering.lettering import Lettering
from marl_lanes.rendering.loading import pygame
from marl_lanes.rendering.options import ViewOptions
from marl_lanes.rendering.palette import WARNING
from marl_lanes.rendering.spotlight import Focus, Incident
from marl_lanes.traffic.machine.state import Outcome, Phase


def write(frame, *, focus=None, incidents=(), cars=(), size=(1280, 720), position=300.0):
    scenario = frame.scenario
    layout, lettering = make_layout(scenario, ViewOptions(size=size)), Lettering()
    camera = Camera(scenario, layout.camera.size, 140.0)
    camera.look_at(position)
    surface = pygame.Surface(size, depth=32)
    labels = Labels(scenario, layout, camera, lettering)
    focus = focus or Focus(-1, None, position, 0)
    labels.draw(surface, frame, focus, list(incidents), None, list(cars))
    found = dict(zip(lettering.texts, lettering.placed, strict=True))
    assert len(found) == len(lettering.texts)
    boxes = list(found.values())
    assert not any(one.colliderect(other) for one, other in itertools.combinations(boxes, 2))
    return camera, found, surface


def test_the_followed_agent_has_its_name_the_others_their_numbers():
    frame = make_frame(commanded(300.0, command=7), commanded(320.0, command=12))
    camera, found, _ = write(frame, focus=Focus(0, 0, 300.0, 1))
    assert {"changer_7", "12"} <= set(found)
    x, y, _ = camera.place(frame.rows["position"], frame.rows["lateral_position"])
    for index, name in enumerate(("changer_7", "12")):
        assert found[name].centerx == pytest.approx(x[index], abs=1.0)
        assert found[name].bottom < y[index]


def test_a_label_stands_where_it_covers_no_vehicle():
    frame = make_frame(commanded(300.0, command=7))
    camera, found, _ = write(frame)
    above = found["7"]
    _, found, _ = write(frame, cars=[above])
    assert not found["7"].colliderect(above)
    _, y, _ = camera.place(300.0, 5.6)
    assert found["7"].top > y
    # If every place is over a vehicle, a label is better than none.
    _, found, _ = write(frame, cars=[pygame.Rect(0, 0, 1280, 720)])
    assert found["7"] == above


def test_positions_are_those_of_the_posts():
    camera, found, _ = write(make_frame(), position=310.0)
    assert {"300 m", "350 m"} <= set(found)
    assert "200 m" not in found
    x, y, _ = camera.place(350.0, camera.road_width)
    assert found["350 m"].centerx == pytest.approx(x, abs=1.0)
    assert found["350 m"].bottom < y
    _, found, _ = write(make_frame(), position=20.0)
    assert "0 m" in found
    assert "-50 m" not in found


def test_the_bar_of_the_scale_is_as_long_as_it_says():
    camera, found, surface = write(make_frame())
    pixels = pygame.surfarray.array3d(surface).swapaxes(0, 1)
    line = pixels[camera.size[1] - 12].any(axis=1).nonzero()[0]
    assert "20 m" in found
    assert line[-1] - line[0] + 1 == pytest.approx(20.0 * camera.scale, abs=1.0)


@pytest.mark.parametrize(
    ("outcome", "text", "has_ring"),
    [
        (Outcome.COMPLETED, "changer_2 completed", False),
        (Outcome.COLLISION, "changer_2 collision", True),
        (Outcome.OFF_ROAD, "changer_2 off road", True),
        (Outcome.MISSED, "changer_2 missed", False),
    ],
)
def test_an_outcome_is_written_at_the_vehicle(outcome, text, has_ring):
    frame = make_frame({"position": 320.0, "lane": 2}, step=5)
    there = Incident(0, 2, outcome, 0.0, 300.0, 5.0, 4.8, 1.8)
    camera, found, _ = write(frame, incidents=[there])
    # The vehicle has moved on.
    assert found[text].centerx == pytest.approx(camera.place(320.0, 5.0)[0], abs=1.0)
    _, found, surface = write(frame, incidents=[there._replace(vehicle=9)])
    x, y, _ = camera.place(300.0, 5.0)
    assert found[text].centerx == pytest.approx(x, abs=1.0)
    radius = (1.3 * 2.4 + 6.0 * 0.5) * camera.scale - 2.0
    right = surface.get_at((int(x + radius), int(y)))
    assert (tuple(right)[:3] == WARNING) == has_ring


def test_a_loss_without_a_command_has_no_name():
    frame = make_frame({"position": 300.0})
    _, found, _ = write(
        frame, incidents=[Incident(0, -1, Outcome.COLLISION, 0.0, 300.0, 2.0, 4.8, 1.8)]
    )
    assert "collision" in found


def test_without_a_panel_time_and_phase_are_in_the_view():
    frame = make_frame(commanded(300.0, phase=Phase.ABORTING, command=7), step=34)
    _, found, _ = write(frame, focus=Focus(0, 0, 300.0, 1), size=(320, 180))
    assert {"3.4 s", "changer_7 aborting"} <= set(found)
    _, found, _ = write(frame, focus=Focus(0, 0, 300.0, 1))
    assert "3.4 s" not in found


def test_a_wide_road_has_its_labels():
    wide = load_scenario({"name": "wide", "road": {"num_lanes": 16}})
    _, found, _ = write(make_frame(scenario=wide))
    assert {"300 m", "20 m"} <= set(found)
    assert STRAIGHT.road.num_lanes == 3
