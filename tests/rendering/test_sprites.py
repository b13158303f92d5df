import math

import numpy as np
import pytest
from pictures import is_colour

from marl_lanes.rendering.loading import pygame
from marl_lanes.rendering.palette import (
    BRAKE_LIGHT,
    CHANGER,
    INDICATOR,
    MARKING,
    ROAD,
    VEHICLE,
    outline_of,
)
from marl_lanes.rendering.sprites import Look, Sprites
from marl_lanes.traffic.machine.state import Disposition

LENGTH, WIDTH = 48.0, 18.0


def paint(look, *, x=50.0, y=50.0, angle=0.0, sprites=None):
    surface = pygame.Surface((100, 100), depth=32)
    surface.fill(ROAD)
    picture, place = (sprites or Sprites(LENGTH, WIDTH)).find(look, x, y, angle)
    surface.blit(picture, place, special_flags=pygame.BLEND_PREMULTIPLIED)
    return pygame.surfarray.array3d(surface).swapaxes(0, 1)


def middle(mask):
    rows, columns = np.nonzero(mask)
    return columns.mean() + 0.5, rows.mean() + 0.5


def covered(picture):
    return ~is_colour(picture, ROAD, 3)


def test_a_vehicle_is_a_rectangle_to_scale():
    picture = paint(Look())
    rows, columns = np.nonzero(covered(picture))
    assert np.ptp(columns) + 1 == pytest.approx(LENGTH, abs=1.5)
    assert np.ptp(rows) + 1 == pytest.approx(WIDTH, abs=1.5)
    assert is_colour(picture, VEHICLE).sum() > 0.5 * LENGTH * WIDTH
    assert not is_colour(picture, CHANGER).any()
    assert is_colour(paint(Look(is_changer=True)), CHANGER).sum() > 0.5 * LENGTH * WIDTH


@pytest.mark.parametrize("degrees", [0.0, 10.0, 90.0, -135.0])
def test_a_turned_vehicle_is_turned_counterclockwise(degrees):
    mask = covered(paint(Look(), angle=math.radians(degrees)))
    rows, columns = np.nonzero(mask)
    covariance = np.cov(columns, -rows)
    _, axes = np.linalg.eigh(covariance)
    found = math.degrees(math.atan2(axes[1, 1], axes[0, 1]))
    assert (found - degrees + 90.0) % 180.0 - 90.0 == pytest.approx(0.0, abs=1.0)
    assert middle(mask) == pytest.approx((50.0, 50.0), abs=0.4)


@pytest.mark.parametrize(("angle", "front"), [(0.0, slice(50, 100)), (math.pi, slice(0, 50))])
def test_the_windscreen_is_in_front(angle, front):
    glass = is_colour(paint(Look(), angle=angle), (38, 46, 58), 4)
    assert glass[:, front].sum() > 0.6 * glass.sum() > 0


def test_fractions_of_a_pixel_count():
    sprites = Sprites(LENGTH, WIDTH)
    middles = [
        middle(covered(paint(Look(), x=50.0 + part / 4.0, y=50.0, sprites=sprites)))[0]
        for part in range(5)
    ]
    weights = [
        paint(Look(), x=50.0 + part / 4.0, sprites=sprites)[50, 74].sum() for part in range(4)
    ]
    assert len(set(weights)) == 4
    assert middles[4] - middles[0] == pytest.approx(1.0, abs=0.01)


@pytest.mark.parametrize(("side", "sign"), [(1, -1.0), (-1, 1.0)])
def test_the_indicator_is_on_the_side_of_the_change(side, sign):
    mask = is_colour(paint(Look(is_changer=True, indicator=side)), INDICATOR, 20)
    assert mask.sum() > 20
    assert sign * (middle(mask)[1] - 50.0) > 0.3 * WIDTH
    assert not is_colour(paint(Look(is_changer=True)), INDICATOR, 20).any()


def test_brake_lights_are_at_the_rear():
    mask = is_colour(paint(Look(is_braking=True)), BRAKE_LIGHT, 20)
    assert mask.sum() > 20
    assert middle(mask) == pytest.approx((50.0 - 0.45 * LENGTH, 50.0), abs=2.0)
    assert not is_colour(paint(Look()), BRAKE_LIGHT, 20).any()


def share_of_rim(look):
    """Of the vehicle's upper edge, the share in the colour of its disposition's outline."""
    picture = paint(look)
    rim = picture[40:44, 32:68]
    return is_colour(rim, outline_of(look.disposition), 60).any(axis=0).mean()


def test_outlines_differ_in_colour_and_pattern():
    shares = {
        disposition: share_of_rim(Look(disposition=disposition)) for disposition in Disposition
    }
    assert shares[Disposition.COOPERATIVE] == 1.0
    assert 0.4 < shares[Disposition.ADVERSARIAL] < 0.9
    assert shares[Disposition.EXTERNAL] == 1.0
    # Two lines: the body begins farther inside than the white line ends.
    column = paint(Look(disposition=Disposition.EXTERNAL))[:, 50].astype(int)
    edge = column[40:46].mean(axis=1)
    assert edge[:3].max() > 180
    assert edge[edge.argmax() :].min() < 90


def test_a_lost_vehicle_is_crossed_out():
    picture = paint(Look(is_lost=True))
    assert is_colour(picture, MARKING, 20).sum() > 80
    assert is_colour(paint(Look()), MARKING, 20).sum() < 8


@pytest.mark.parametrize("size", [(3.0, 2.0), (11.0, 4.0), (20.0, 7.5), (300.0, 20.0)])
@pytest.mark.parametrize("disposition", Disposition)
def test_every_size_shows_the_body(size, disposition):
    sprites = Sprites(*size)
    picture, _ = sprites.find(Look(disposition=disposition), 0.0, 0.0, 0.0)
    shown = pygame.surfarray.array3d(picture)
    assert is_colour(shown, VEHICLE, 60).any()


def test_a_look_is_drawn_once():
    sprites = Sprites(LENGTH, WIDTH)
    first, _ = sprites.find(Look(), 10.0, 10.0, 0.0)
    again, place = sprites.find(Look(), 110.1, 60.1, 0.001)
    assert again is first
    assert place == (100 + 10 - first.get_width() // 2, 60 - first.get_height() // 2)


def test_a_long_body_has_a_joint_behind_the_cab_and_no_rear_window():
    picture = paint(Look(), sprites=Sprites(92.0, 14.0))
    dark = ~is_colour(picture, VEHICLE, 60) & covered(picture)
    # Along the middle, 6 px from the rear bumper to 3 px from the front one, at 4 and 96 px.
    (columns,) = np.nonzero(dark[50, 10:93])
    joint, windscreen = np.split(10 + columns, np.flatnonzero(np.diff(columns) > 1) + 1)
    assert joint.mean() == pytest.approx(96.0 - 1.11 * 14.0, abs=1.0)
    assert windscreen.mean() == pytest.approx(96.0 - 0.31 * 14.0, abs=1.0)
