import dataclasses
import itertools
import re

import numpy as np
import pytest
from colorspacious import cspace_convert

from marl_lanes.colours import DARK, LIGHT, TRAFFIC

SIGHTS = {
    "trichromacy": None,
    "protanopia": "protanomaly",
    "deuteranopia": "deuteranomaly",
    "tritanopia": "tritanomaly",
}
"""Colour vision, and the name of its kind in colorspacious; at full severity it is the opia."""

MIN_DISTANCE = 15.0
"""In CAM02-UCS, between any two colours that must be told apart. Neighbors of Okabe and Ito's set
are 11 apart; 1 is just noticeable side by side."""

TOGETHER = {
    "series": (*LIGHT.series, LIGHT.text),
    "dark series": (*DARK.series, DARK.text),
    "bodies on the road": (TRAFFIC.changer, TRAFFIC.vehicle, TRAFFIC.road, TRAFFIC.marking),
    "road on the ground": (TRAFFIC.road, LIGHT.ground),
    "outlines around a body": (
        TRAFFIC.vehicle,
        TRAFFIC.cooperative,
        TRAFFIC.neutral,
        TRAFFIC.adversarial,
        TRAFFIC.external,
    ),
    # A neutral vehicle's outline is dark like the road: it looks like none.
    "outlines on the road": (
        TRAFFIC.road,
        TRAFFIC.cooperative,
        TRAFFIC.adversarial,
        TRAFFIC.external,
    ),
    "lights of a changer": (
        TRAFFIC.changer,
        TRAFFIC.road,
        TRAFFIC.indicator,
        TRAFFIC.brake_light,
    ),
    "lights of the others": (
        TRAFFIC.vehicle,
        TRAFFIC.road,
        TRAFFIC.indicator,
        TRAFFIC.brake_light,
    ),
    "gaps": (
        TRAFFIC.safe_gap,
        TRAFFIC.refused_gap,
        TRAFFIC.road,
        TRAFFIC.marking,
        TRAFFIC.changer,
        TRAFFIC.vehicle,
    ),
}
"""Colours that appear side by side."""


def read(colour):
    """Red, green and blue from 0 to 1."""
    return np.array([int(colour[start : start + 2], 16) for start in (1, 3, 5)]) / 255.0


def see(colour, sight):
    """The colour's place in CAM02-UCS for eyes of that sight."""
    seen = read(colour)
    if SIGHTS[sight] is not None:
        space = {"name": "sRGB1+CVD", "cvd_type": SIGHTS[sight], "severity": 100}
        seen = np.clip(cspace_convert(seen, space, "sRGB1"), 0.0, 1.0)
    return cspace_convert(seen, "sRGB1", "CAM02-UCS")


def measure_distance(one, other, sight):
    return float(np.linalg.norm(see(one, sight) - see(other, sight)))


def measure_contrast(one, other):
    """Ratio of the relative luminances, 1 to 21 (WCAG 2.2)."""

    def luminance(colour):
        value = read(colour)
        linear = np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)
        return float(linear @ [0.2126, 0.7152, 0.0722])

    dark, light = sorted((luminance(one), luminance(other)))
    return (light + 0.05) / (dark + 0.05)


@pytest.mark.parametrize("sight", SIGHTS)
@pytest.mark.parametrize("group", TOGETHER)
def test_colours_side_by_side_can_be_told_apart(group, sight):
    pairs = list(itertools.combinations(TOGETHER[group], 2))
    near = {
        pair: round(measure_distance(*pair, sight), 1)
        for pair in pairs
        if measure_distance(*pair, sight) < MIN_DISTANCE
    }
    assert near == {}


def test_red_and_green_fail_this_check():
    """The measure sees what it is for."""
    assert measure_distance("#d62728", "#2ca02c", "trichromacy") > 50.0
    worst = min(measure_distance("#c0504d", "#7a7a20", sight) for sight in SIGHTS)
    assert worst < MIN_DISTANCE


@pytest.mark.parametrize("theme", [LIGHT, DARK], ids=["light", "dark"])
def test_contrast_to_the_background(theme):
    """Text as WCAG AA asks (4.5), lines and marks as it asks of graphics (3)."""
    for place in (theme.background, theme.panel):
        for name in ("text", "muted", "link", "warning"):
            assert measure_contrast(getattr(theme, name), place) >= 4.5, (name, place)
    for colour in theme.series:
        assert measure_contrast(colour, theme.background) >= 3.0, colour


def test_contrast_on_the_road():
    for field in dataclasses.fields(TRAFFIC):
        if field.name not in {"road", "neutral"}:
            colour = getattr(TRAFFIC, field.name)
            assert measure_contrast(colour, TRAFFIC.road) >= 2.5, field.name
    assert measure_contrast("#000000", "#ffffff") == pytest.approx(21.0)


def test_every_colour_is_six_digits():
    found = [
        colour
        for kind in (LIGHT, DARK, TRAFFIC)
        for value in dataclasses.asdict(kind).values()
        for colour in (value if isinstance(value, tuple) else (value,))
    ]
    assert len(found) > 35
    assert [colour for colour in found if not re.fullmatch(r"#[0-9a-f]{6}", colour)] == []
