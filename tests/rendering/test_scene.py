import math

import numpy as np
import pytest
from pictures import LEFT_BEND, STRAIGHT, commanded, crop, find_bodies, is_colour, make_frame

from marl_lanes.rendering.camera import Camera
from marl_lanes.rendering.layout import make_layout
from marl_lanes.rendering.lettering import Lettering
from marl_lanes.rendering.loading import pygame
from marl_lanes.rendering.options import ViewOptions
from marl_lanes.rendering.palette import (
    BRAKE_LIGHT,
    CHANGER,
    INDICATOR,
    REFUSED_GAP,
    ROAD,
    SAFE_GAP,
    VEHICLE,
    mix,
)
from marl_lanes.rendering.scene import BLINK_TIME, Scene, find_gap, find_looks, is_lit
from marl_lanes.rendering.spotlight import Focus
from marl_lanes.traffic.machine.state import Disposition, Fate, Outcome, Phase

NOBODY = Focus(-1, None, 0.0, 0)


def paint(frame, *, position=300.0, focus=NOBODY):
    layout = make_layout(frame.scenario, ViewOptions())
    camera, lettering = Camera(frame.scenario, layout.camera.size, 140.0), Lettering()
    camera.look_at(position)
    surface = pygame.Surface((1280, 720), depth=32)
    Scene(frame.scenario, layout, camera, lettering).draw(surface, frame, focus, [])
    picture = pygame.surfarray.array3d(surface).swapaxes(0, 1)
    assert not picture[layout.camera.bottom :].any()
    return camera, lettering, crop(picture, layout.camera)


@pytest.mark.parametrize("scenario", [STRAIGHT, LEFT_BEND], ids=lambda one: one.name)
def test_vehicles_are_where_their_rows_say(scenario):
    cars = [{"position": place, "lane": lane} for lane in range(3) for place in (270, 300, 340)]
    camera, _, picture = paint(make_frame(*cars, {"position": 500.0}, scenario=scenario))
    rows = make_frame(*cars, scenario=scenario).rows
    x, y, _ = camera.place(rows["position"], rows["lateral_position"])
    found = np.asarray(find_bodies(picture, VEHICLE, 100))
    assert len(found) == len(cars)
    distances = np.hypot(found[:, :1] - x, found[:, 1:] - y)
    assert distances.min(axis=0).max() < 1.8


def test_a_turned_vehicle_is_turned_by_yaw_and_road():
    for scenario, position in ((STRAIGHT, 330.0), (LEFT_BEND, 340.0)):
        cars = [{"position": position, "lane": 1, "yaw": yaw} for yaw in (0.0, 0.3, -0.3)]
        for car in cars:
            camera, _, picture = paint(make_frame(car, scenario=scenario))
            _, _, heading = camera.place(position, 5.0)
            rows, columns = is_colour(picture, VEHICLE, 60).nonzero()
            _, axes = np.linalg.eigh(np.cov(columns, -rows))
            found = np.arctan(axes[1, 1] / axes[0, 1])
            assert found == pytest.approx(float(heading) + car["yaw"], abs=0.03)


def test_what_a_vehicle_looks_like():
    rows = make_frame(
        {"position": 1.0},
        commanded(2.0, direction=-1, acceleration=-0.6),
        {"position": 3.0, "moving_over": 1, "acceleration": -0.4},
        {"position": 4.0, "disposition": 4, "fate": Fate.STRAYS},
        {"position": 5.0, "outcome": Outcome.COMPLETED, "fate": Fate.LEAVES, "disposition": 2},
        commanded(6.0, direction=-1, phase=Phase.ABORTING),
    ).rows
    looks = find_looks(rows, 0.0)
    assert [look.is_changer for look in looks] == [False, True, False, False, True, True]
    assert [look.is_braking for look in looks] == [False, True, False, False, False, False]
    assert [look.indicator for look in looks] == [0, -1, 1, 0, 0, 1]
    assert [look.is_lost for look in looks] == [False, False, False, True, False, False]
    assert [look.disposition for look in looks][2:5] == [
        Disposition.COOPERATIVE,
        Disposition.EXTERNAL,
        Disposition.ADVERSARIAL,
    ]
    assert not any(look.indicator for look in find_looks(rows, BLINK_TIME))


def test_indicators_blink_with_time():
    lit = [is_lit(step * 0.1) for step in range(16)]
    assert lit == [True, True, True, True, False, False, False, False] * 2


def test_lights_are_in_the_picture():
    agent = commanded(300.0, lane=1, direction=1, acceleration=-2.0)
    _, _, picture = paint(make_frame(agent))
    ((x, y),) = find_bodies(picture, CHANGER, 100)
    lamps = find_bodies(picture, INDICATOR, 4)
    assert len(lamps) == 2
    assert all(y - 12.0 < lamp[1] < y - 4.0 for lamp in lamps)
    brakes = find_bodies(picture, BRAKE_LIGHT, 4)
    assert len(brakes) == 2
    assert all(lamp[0] < x - 15.0 for lamp in brakes)
    _, _, dark = paint(make_frame({**agent, "acceleration": 0.0}, step=4))
    assert not find_bodies(dark, INDICATOR, 4)
    assert not find_bodies(dark, BRAKE_LIGHT, 4)


GAP = (
    commanded(300.0, phase=Phase.ENGAGED, target_leader=1, target_follower=2),
    {"position": 330.0, "lane": 2},
    {"position": 280.0, "lane": 2},
    {"position": 315.0, "lane": 0},
)


@pytest.mark.parametrize(
    ("phase", "is_accepted"),
    [(Phase.WAITING, False), (Phase.ENGAGED, True), (Phase.ABORTING, False)],
)
def test_the_gap_is_between_the_target_lanes_vehicles(phase, is_accepted):
    frame = make_frame({**GAP[0], "phase": phase}, *GAP[1:])
    camera, lettering, picture = paint(frame, focus=Focus(0, 0, 300.0, 1))
    gap = find_gap(frame.rows, 0, camera)
    assert (gap.lane, gap.rear, gap.front) == (2, pytest.approx(282.4), pytest.approx(327.6))
    assert gap.is_hatched != is_accepted
    colour = mix(ROAD, SAFE_GAP, 0.5) if is_accepted else mix(ROAD, REFUSED_GAP, 0.8)
    rows, columns = is_colour(picture, colour, 6).nonzero()
    x, y, _ = camera.place([282.4, 327.6], 2.5 * 3.75)
    assert (columns.min(), columns.max()) == pytest.approx((x[0], x[1]), abs=14.0)
    assert rows.mean() == pytest.approx(y[0], abs=3.0)
    # Metres from bumper to bumper: behind and ahead.
    assert {"15.2 m", "25.2 m"} <= set(lettering.texts)


def test_an_open_gap_reaches_beyond_the_picture():
    camera, lettering, _ = paint(make_frame(commanded(300.0)), focus=Focus(0, 0, 300.0, 1))
    gap = find_gap(make_frame(commanded(300.0)).rows, 0, camera)
    assert (gap.rear, gap.front) == camera.reach
    assert not any(text.endswith(".0 m") or "." in text for text in lettering.texts)


def test_without_a_command_there_is_no_gap():
    frame = make_frame({"position": 300.0})
    camera, _, picture = paint(frame, focus=Focus(0, 0, 300.0, 0))
    assert find_gap(frame.rows, 0, camera) is None
    assert not is_colour(picture, mix(ROAD, SAFE_GAP, 0.5), 6).any()


def test_an_empty_road_is_drawn():
    _, _, picture = paint(make_frame())
    assert find_bodies(picture, VEHICLE) == []
    assert is_colour(picture, ROAD, 0).mean() > 0.2


def test_a_truck_is_drawn_as_long_and_as_wide_as_it_is():
    cars = {"position": 280.0, "lane": 0}, {"position": 300.0, "lane": 2, "profile": 3}
    camera, _, picture = paint(make_frame(*cars))
    for car, length, width in zip(cars, (4.8, 16.5), (1.8, 2.55), strict=True):
        lane = car["lane"]
        bounds = camera.place([car["position"]] * 2, [3.75 * lane, 3.75 * (lane + 1)])[1]
        within = picture[math.ceil(bounds[1]) + 4 : math.floor(bounds[0]) - 4]
        rows, columns = (~is_colour(within, ROAD, 12)).nonzero()
        assert (np.ptp(columns) + 1) / camera.scale == pytest.approx(length, abs=0.3)
        assert (np.ptp(rows) + 1) / camera.scale == pytest.approx(width, abs=0.3)


def test_the_gap_of_a_truck_is_between_bumpers():
    """Half of the truck is 8.25 m: a gap of 0 m is no distance, and it is where bumpers touch."""
    truck = {"profile": 3}
    leader, follower = {"position": 320.65, "lane": 2}, {"position": 289.35, "lane": 2}
    agent = commanded(300.0, phase=Phase.ENGAGED, target_leader=1, target_follower=2, **truck)
    camera, lettering, _ = paint(make_frame(agent, leader, follower), focus=Focus(0, 0, 300.0, 1))
    gap = find_gap(make_frame(agent, leader, follower).rows, 0, camera)
    assert (gap.rear, gap.front) == (pytest.approx(291.75), pytest.approx(318.25))
    assert gap.distances == ((pytest.approx(308.25), pytest.approx(318.25)),)
    assert "10.0 m" in lettering.texts
    leader["profile"], leader["position"] = 3, 330.0
    gap = find_gap(make_frame(agent, leader, follower).rows, 0, camera)
    assert gap.front == pytest.approx(321.75)
