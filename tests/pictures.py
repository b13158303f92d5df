"""Frames that are put together, and what is seen in pictures, for tests of the drawing."""

import numpy as np
from scipy import ndimage

from marl_lanes import load_scenario
from marl_lanes.rendering.palette import CHANGER, VEHICLE
from marl_lanes.trajectory.columns import new_rows, set_bodies
from marl_lanes.trajectory.frames import Frame

STRAIGHT = load_scenario("paper")
LEFT_BEND = load_scenario(
    {"name": "bend", "road": {"arcs": [{"start": 50.0, "end": 950.0, "radius": 200.0}]}}
)
"""Bends to the left."""


def make_frame(*cars, scenario=STRAIGHT, step=0, road=0):
    """A frame of cars, each the columns that differ from those of a car that drives straight.

    Cars are numbered in their order, and drive in the middle of their lanes.
    """
    rows = new_rows(len(cars))
    rows["step"], rows["time"] = step, step * scenario.time_step
    rows["vehicle"] = np.arange(len(cars))
    for row, car in zip(rows, cars, strict=True):
        row["lateral_position"] = (car.get("lane", 0) + 0.5) * scenario.road.lane_width
        row["speed"] = 25.0
        for name, value in car.items():
            row[name] = value
    set_bodies(rows, scenario)
    return Frame(scenario, road, step, rows)


def commanded(position, lane=1, direction=1, phase=1, **others):
    """A car with a command."""
    return {
        "position": position,
        "lane": lane,
        "command": 0,
        "phase": phase,
        "direction": direction,
        "origin_lane": lane,
        "target_lane": lane + direction,
        **others,
    }


def is_colour(picture, colour, tolerance=10):
    """(height, width): which pixels have a colour."""
    return (np.abs(picture.astype(int) - colour) <= tolerance).all(axis=2)


def find_bodies(picture, colour, least=6):
    """Middles (x, y) of the connected patches of a colour with at least so many pixels."""
    patches, count = ndimage.label(is_colour(picture, colour), np.ones((3, 3)))
    sizes = ndimage.sum_labels(np.ones(patches.shape), patches, range(1, count + 1))
    chosen = 1 + np.flatnonzero(np.asarray(sizes) >= least)
    middles = ndimage.center_of_mass(np.ones(patches.shape), patches, chosen)
    return sorted((x, y) for y, x in middles)


def find_cars(picture):
    """Middles of all vehicles, red and yellow."""
    return sorted(find_bodies(picture, CHANGER) + find_bodies(picture, VEHICLE))


def crop(picture, rect):
    """The part of a picture in a rectangle."""
    return picture[rect.top : rect.bottom, rect.left : rect.right]


def count_colours(picture):
    """Number of different colours."""
    red, green, blue = np.moveaxis(picture.astype(np.uint32), -1, 0)
    return np.unique(red << 16 | green << 8 | blue).size
