import math

import numpy as np
import pytest
from pictures import LEFT_BEND, STRAIGHT

from marl_lanes import load_scenario
from marl_lanes.rendering.camera import BEHIND, MARGIN, Camera

SHARP = load_scenario(
    {
        "name": "sharp",
        "road": {
            "arcs": [
                {"start": 100.0, "end": 300.0, "radius": 60.0},
                {"start": 330.0, "end": 700.0, "radius": -70.0},
            ]
        },
    }
)
"""Bends left, then right."""


def seen(camera):
    """Position and lateral position of every pixel, (height, width) each."""
    grids = np.broadcast_arrays(*map(camera.spread, camera.look_up()))
    assert grids[0].shape == camera.size[::-1]
    return grids


def test_the_scale_is_the_same_in_both_directions():
    camera = Camera(STRAIGHT, (1400, 400), 140.0)
    camera.look_at(500.0)
    assert camera.scale == 10.0
    x, y, heading = camera.place([500.0, 510.0, 500.0], [5.625, 5.625, 8.625])
    assert x == pytest.approx([BEHIND * 1400, BEHIND * 1400 + 100.0, BEHIND * 1400])
    # The left of the road is the top of the picture.
    assert y == pytest.approx([200.0, 200.0, 170.0])
    assert heading == pytest.approx([0.0, 0.0, 0.0])
    assert (camera.start, camera.end) == pytest.approx((500.0 - BEHIND * 140.0, 581.2))


def test_a_wide_road_is_seen_in_full():
    wide = load_scenario({"name": "wide", "road": {"num_lanes": 16}})
    camera = Camera(wide, (1400, 400), 140.0)
    assert camera.scale == pytest.approx(400 / (60.0 + 2.0 * MARGIN))
    _, y, _ = camera.place([0.0, 0.0], [0.0, 60.0])
    assert y.max() < 400
    assert y.min() > 0


@pytest.mark.parametrize("scenario", [STRAIGHT, LEFT_BEND, SHARP], ids=lambda one: one.name)
@pytest.mark.parametrize("position", [0.0, 200.0, 390.0, 995.0])
def test_pixels_and_places_are_inverse(scenario, position):
    camera = Camera(scenario, (640, 200), 120.0)
    camera.look_at(position)
    along, across = seen(camera)
    places = np.linspace(camera.start + 5.0, camera.end - 5.0, 40)
    for lateral in (0.3, 5.0, 11.0):
        x, y, _ = camera.place(places, lateral)
        is_in = (x > 1) & (x < 638) & (y > 1) & (y < 198)
        assert is_in.sum() > 10
        columns, rows = x[is_in].astype(int), y[is_in].astype(int)
        pixel = 1.0 / camera.scale
        assert along[rows, columns] == pytest.approx(places[is_in], abs=1.2 * pixel)
        assert across[rows, columns] == pytest.approx(lateral, abs=1.2 * pixel)


def test_the_road_is_horizontal_at_the_looked_at_position():
    camera = Camera(SHARP, (640, 200), 120.0)
    for position in (0.0, 150.0, 250.0, 500.0):
        camera.look_at(position)
        x, y, heading = camera.place([position, position + 0.1], [5.625, 5.625])
        assert (x[0], y[0], heading[0]) == pytest.approx((BEHIND * 640, 100.0, 0.0))
        assert abs(y[1] - y[0]) < 0.02 * (x[1] - x[0])


def test_positive_curvature_bends_to_the_left():
    camera = Camera(LEFT_BEND, (1280, 400), 140.0)
    camera.look_at(500.0)
    _, y, heading = camera.place([450.0, 500.0, 550.0], 0.0)
    assert y[0] < y[1]
    assert y[2] < y[1]
    assert heading[2] == pytest.approx(50.0 / 200.0, abs=1e-3)
    # The chord of the arc: r (1 - cos(50 m/r)) to the left.
    assert (y[1] - y[2]) / camera.scale == pytest.approx(200.0 * (1.0 - math.cos(0.25)), rel=1e-3)
