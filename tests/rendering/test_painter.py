import itertools
import os

import numpy as np
import pytest
import recordings
from pictures import (
    CHANGER,
    STRAIGHT,
    VEHICLE,
    commanded,
    count_colours,
    crop,
    find_bodies,
    find_cars,
    make_frame,
)

from marl_lanes import load_scenario
from marl_lanes.rendering.loading import pygame
from marl_lanes.rendering.options import ViewOptions
from marl_lanes.rendering.painter import Painter
from marl_lanes.traffic.machine.state import Fate, Outcome

SIZES = [(320, 180), (640, 360), (1280, 720), (3840, 2160), (320, 2160), (3840, 180)]


def frames_of(trajectory, steps):
    road = trajectory.roads[0]
    return [frame for frame in trajectory.frames(road) if frame.step in steps]


def view(painter, frame):
    return crop(painter.draw(frame), painter.layout.camera)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["paper", "interactive"])
def test_the_picture_has_the_vehicles_of_its_frame(name):
    trajectory = getattr(recordings, name)()
    painter = Painter(trajectory.scenario)
    counts = []
    for frame in frames_of(trajectory, range(0, 500, 25)):
        picture = view(painter, frame)
        camera, rows = painter.camera, frame.rows
        assert 12.0 < picture.mean() < 120.0
        assert count_colours(picture) > 50
        # Those at the edge may be there in part.
        inner = (rows["position"] > camera.start + 3.0) & (rows["position"] < camera.end - 3.0)
        outer = (rows["position"] > camera.start - 3.0) & (rows["position"] < camera.end + 3.0)
        count = len(find_cars(picture))
        assert inner.sum() <= count <= outer.sum(), frame.step
        counts.append(count)
    assert max(counts) >= 3


def test_a_lane_change_is_seen():
    painter = Painter(STRAIGHT)
    places = []
    for step, lateral in enumerate((5.625, 7.5, 9.375)):
        agent = commanded(300.0 + step, phase=2, yaw=0.05, lateral_position=lateral)
        (one,) = find_bodies(view(painter, make_frame(agent, step=step)), CHANGER, 100)
        places.append(one)
    moved = (places[0][1] - places[2][1]) / painter.camera.scale
    assert moved == pytest.approx(STRAIGHT.road.lane_width, abs=0.1)
    assert places[0][0] == pytest.approx(places[2][0], abs=1.0)


def test_the_road_moves_below_the_followed_vehicle():
    painter = Painter(STRAIGHT)
    first, second, same = (
        view(painter, make_frame({"position": place, "lane": 0}, step=step))[:100]
        for step, place in enumerate((300.0, 305.0, 300.0))
    )
    assert (first != second).any()
    assert (first == same).all()


def test_the_same_frames_give_the_same_bytes():
    frames = [
        make_frame(commanded(300.0 + step, phase=2), {"position": 320.0}, step=step)
        for step in range(8)
    ]
    first, second = Painter(STRAIGHT), Painter(STRAIGHT)
    pictures = [first.draw(frame) for frame in frames]
    again = [second.draw(frame) for frame in frames for _ in range(2)]
    for picture, one, other in zip(pictures, again[::2], again[1::2], strict=True):
        assert picture.tobytes() == one.tobytes() == other.tobytes()
    assert pictures[0].tobytes() != pictures[5].tobytes()


def test_a_picture_is_not_overwritten_by_the_next():
    painter = Painter(STRAIGHT)
    first = painter.draw(make_frame({"position": 100.0}))
    before = first.copy()
    painter.draw(make_frame({"position": 300.0}, step=1))
    assert (first == before).all()
    assert first.flags.writeable
    assert first.flags.c_contiguous


@pytest.mark.parametrize("size", SIZES, ids=str)
@pytest.mark.parametrize("num_lanes", [3, 16])
def test_texts_do_not_overlap_at_any_size(size, num_lanes):
    raw = {"name": "a name of some length", "road": {"num_lanes": num_lanes}}
    scenario = load_scenario(raw)
    painter = Painter(scenario, ViewOptions(size=size), title="runs/with/a/long/name/model.pt")
    agents = [
        commanded(place, lane=1, command=number, phase=1 + number % 3, target_leader=7, reward=-0.1)
        for number, place in enumerate((280.0, 290.0, 298.0, 306.0, 320.0, 330.0))
    ]
    lost = {"position": 300.0, "lane": 2, "fate": Fate.COLLIDES, "outcome": Outcome.COLLISION}
    frame = make_frame(*agents, lost, {"position": 340.0, "lane": 2}, scenario=scenario, step=7)
    picture = painter.draw(frame)
    assert picture.shape == (size[1], size[0], 3)
    assert picture.dtype == np.uint8
    placed, whole = painter.lettering.placed, pygame.Rect((0, 0), size)
    assert all(whole.contains(box) for box in placed)
    assert not any(one.colliderect(other) for one, other in itertools.combinations(placed, 2))
    assert any(text == "0.7 s" for text in painter.lettering.texts)
    assert any(text.startswith("changer_") for text in painter.lettering.texts)


@pytest.mark.parametrize(
    "road",
    [
        {"length": 100.0, "num_lanes": 2},
        {"length": 1e5, "num_lanes": 2},
        {"num_lanes": 16, "lane_width": 6.0},
        {"arcs": [{"start": 0.0, "end": 1000.0, "radius": -50.0, "transition": 60.0}]},
    ],
    ids=str,
)
@pytest.mark.parametrize("body", [(2.0, 0.5), (20.0, 2.5)], ids=str)
def test_every_road_and_vehicle_is_drawn(road, body):
    scenario = load_scenario(
        {
            "name": "road",
            "road": road,
            "command": {"position": [40.0, 60.0], "probability": 0.0},
            "vehicle": {"length": body[0], "width": body[1]},
            "drivers": {"profiles": {"normal": {"comfortable_lateral_acceleration": 0.5}}},
        }
    )
    painter = Painter(scenario)
    picture = view(painter, make_frame({"position": 60.0, "lane": 1}, scenario=scenario))
    found = find_bodies(picture, VEHICLE, 3)[0]
    x, y, _ = painter.camera.place(60.0, 1.5 * scenario.road.lane_width)
    assert found == pytest.approx((float(x), float(y)), abs=0.6 * body[0] * painter.camera.scale)


def test_a_road_without_vehicles_is_not_black():
    picture = view(Painter(STRAIGHT), make_frame())
    assert picture.mean() > 20.0


@pytest.mark.parametrize("size", [(320, 180), (1280, 720)])
def test_a_lost_vehicle_is_marked_in_the_step_that_removes_it(size):
    painter = Painter(STRAIGHT, ViewOptions(size=size))
    going = commanded(300.0, phase=2)
    lost = {**going, "phase": 0, "outcome": Outcome.OFF_ROAD, "fate": Fate.STRAYS}
    painter.draw(make_frame(going))
    before = view(painter, make_frame(going, step=1))
    after = view(painter, make_frame(lost, step=1))
    assert (before != after).any(axis=2).sum() > 40
    assert "changer_0 off road" in painter.lettering.texts
    # The vehicle is gone; what happened stays for a moment.
    view(painter, make_frame({"position": 500.0, "vehicle": 5}, step=2))
    assert "changer_0 off road" in painter.lettering.texts


def test_a_frame_that_is_not_drawn_is_remembered():
    lost = {"position": 300.0, "command": 4, "outcome": Outcome.OFF_ROAD, "fate": Fate.STRAYS}
    painter = Painter(STRAIGHT, {"size": (640, 360)})
    painter.note(make_frame(commanded(299.0, command=4, phase=2)))
    painter.note(make_frame(lost, step=1))
    painter.draw(make_frame({"position": 500.0, "vehicle": 5}, step=2))
    assert "changer_4 off road" in painter.lettering.texts


def test_no_display_is_opened():
    Painter(STRAIGHT).draw(make_frame({"position": 100.0}))
    assert not pygame.display.get_init()
    assert pygame.display.get_surface() is None
    assert "SDL_VIDEODRIVER" not in os.environ
