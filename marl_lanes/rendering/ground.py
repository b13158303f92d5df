"""The ground from above: road, markings, verge, and the gap that the rule looks at."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from marl_lanes.rendering.camera import CELL, Camera, FloatArray
from marl_lanes.rendering.loading import pygame
from marl_lanes.rendering.palette import GROUND, MARKING, ROAD, Colour, mix
from marl_lanes.scenario import Scenario

DASH_LENGTH = 6.0
DASH_PERIOD = 18.0
"""[m] Of the lane markings, as on a motorway."""

POST_SPACING = 50.0
"""[m] Between two posts beside the road."""

_LINE_WIDTH = 0.15
_EDGE_WIDTH = 0.3
"""[m] Of the markings between lanes and at the edges; the latter lie outside the lanes."""

_PAVED = 0.9
"""[m] Of asphalt beside the outer lanes."""

_POST_DISTANCE = 1.6
_POST_WIDTH = 0.5
"""[m] Of a post from the lanes, and its size."""

_STRIPE = 25.0
"""[m] Length of the mowed stripes on the verge, which show the motion beside the road."""

_MIN_PIXELS = 1.2
"""Least width of a marking in the picture."""

_STEPS = 8
"""Rows of the table of colours for each pixel across the road, and levels of coverage."""

_FINE = 4
"""Positions for each pixel along the road."""

_INSET = 0.12
"""Of the gap's band from the lane's edges, in lane widths."""

_END_STROKE = 0.2
"""Half length of the strokes at the ends of a distance, in lane widths."""

_PLAIN = 0.5
"""Share of the colour in an accepted gap."""

_HATCH, _STROKE = 2.4, 0.6
"""[m] Between two strokes of a refused gap along the road, and their width."""

_HATCH_GROUND, _HATCH_STROKE = 0.2, 0.8
"""Share of the colour between the strokes and on them."""


class Gap(NamedTuple):
    """The gap in the target lane, drawn as a band."""

    lane: int
    rear: float
    """Front bumper of the target follower [m]; where there is none, the picture's edge or less."""
    front: float
    """Rear bumper of the target leader [m]."""
    colour: Colour
    is_hatched: bool
    distances: tuple[tuple[float, float], ...] = ()
    """From position to position [m], shown by lines along the lane."""


class Ground:
    """Draws the ground into a surface of the camera's size.

    The colour of a pixel is looked up in a table: its row is the distance from the road's edge,
    in eighths of a pixel, its column says what is at the position along the road. Edges are smooth,
    because the table holds the share of a pixel that a marking covers.

    Args:
        scenario: of the road.
        camera: through which it is seen.
    """

    def __init__(self, scenario: Scenario, camera: Camera) -> None:
        self._road = scenario.road
        self._camera = camera
        self._scale = camera.scale
        self._tables: dict[int | None, NDArray[np.uint32]] = {}
        # Farther from the road all ground looks the same. Places are cut off there before the
        # camera spreads them over the pixels of its cells, none of which may hold a marking then.
        reach = _POST_DISTANCE + 2.0 * max(_POST_WIDTH, _MIN_PIXELS / self._scale)
        reach += math.sqrt(2.0) * CELL / self._scale
        self._lowest = -reach
        self._last_row = int((2.0 * reach + camera.road_width) * self._scale * _STEPS)

    def draw(self, surface: "pygame.Surface", target_lane: int | None, gap: Gap | None) -> None:
        """Draw the ground.

        Args:
            surface: of the camera's size, 32 bits a pixel.
            target_lane: whose centre is dotted.
            gap: to be shown.
        """
        camera = self._camera
        position, lateral_position = camera.look_up()
        start = float(position.min())
        place = (position - start) * (self._scale * _FINE)
        row = np.clip((lateral_position - self._lowest) * (self._scale * _STEPS), 0, self._last_row)
        kinds = self._classify(start, float(position.max()))
        table = self._table(target_lane)
        pixels = pygame.surfarray.pixels2d(surface).T
        block = None if gap is None else self._bound(gap)
        for band, (places, rows) in camera.spread(place, row):
            index = rows.astype(np.intp) * table.shape[1]
            pixels[band] = np.take(table, index + kinds.take(places.astype(np.intp)))
            if gap is not None and block is not None:
                within = slice(max(block[0].start, band.start), min(block[0].stop, band.stop))
                tall = slice(within.start - band.start, max(within.stop - band.start, 0))
                along = places[tall if places.shape[0] > 1 else ..., block[1]]
                across = rows[tall, block[1] if rows.shape[1] > 1 else ...]
                self._blend(
                    pixels[within, block[1]],
                    start + along / (self._scale * _FINE),
                    self._lowest + across / (self._scale * _STEPS),
                    gap,
                )

    def _classify(self, start: float, end: float) -> NDArray[np.intp]:
        """What is at positions from start to end, _FINE for each pixel: a column of the table.

        The column is dash + 9 (post + 2 (stripe + 2 dot)), or the last beyond the road's ends.
        """
        count = int((end - start) * self._scale * _FINE) + 2
        place = start + (np.arange(count) + 0.5) / (_FINE * self._scale)
        dash = self._cover(place, DASH_PERIOD, 0.5 * DASH_LENGTH)
        dash_level = np.rint(dash * _STEPS).astype(np.int32)
        half_post = 0.5 * max(_POST_WIDTH, 2.0 / self._scale)
        post = self._cover(place, POST_SPACING, half_post) > 0.5
        stripe = np.floor(place / _STRIPE).astype(np.int32) % 2
        dot = self._cover(place, 3.0, 0.5) > 0.5
        columns = dash_level + (_STEPS + 1) * (post + 2 * (stripe + 2 * dot))
        is_outside = (place < 0.0) | (place > self._road.length)
        return np.where(is_outside, 8 * (_STEPS + 1), columns).astype(np.intp)

    def _cover(self, place: FloatArray, period: float, half: float) -> FloatArray:
        """Share of a pixel that marks around the multiples of a period cover."""
        distance = np.abs(place - period * np.rint(place / period))
        return np.asarray(np.clip((half - distance) * self._scale + 0.5, 0.0, 1.0))

    def _table(self, target_lane: int | None) -> NDArray[np.uint32]:
        """(rows, columns) colours as 0xrrggbb."""
        if target_lane not in self._tables:
            self._tables[target_lane] = self._make_table(target_lane)
        return self._tables[target_lane]

    def _make_table(self, target_lane: int | None) -> NDArray[np.uint32]:
        road, width = self._road, self._camera.road_width
        across = self._lowest + (np.arange(self._last_row + 1) + 0.5) / (self._scale * _STEPS)
        paved = self._band(across, -_PAVED, width + _PAVED)
        edge = self._stroke(across, -0.5 * _EDGE_WIDTH, _EDGE_WIDTH)
        edge += self._stroke(across, width + 0.5 * _EDGE_WIDTH, _EDGE_WIDTH)
        between = np.zeros_like(across)
        for lane in range(1, road.num_lanes):
            between += self._stroke(across, lane * road.lane_width, _LINE_WIDTH)
        posts = self._stroke(across, -_POST_DISTANCE, _POST_WIDTH)
        posts += self._stroke(across, width + _POST_DISTANCE, _POST_WIDTH)
        centre = np.zeros_like(across)
        if target_lane is not None:
            centre = self._stroke(across, (target_lane + 0.5) * road.lane_width, _LINE_WIDTH)
        columns = []
        for number in range(8 * (_STEPS + 1)):
            kind, dash = divmod(number, _STEPS + 1)
            has_post, is_light, has_dot = kind & 1, kind >> 1 & 1, kind >> 2 & 1
            ground = mix(GROUND, MARKING, 0.025) if is_light else GROUND
            colours = _over(np.asarray(ground, np.float64), ROAD, paved)
            colours = _over(colours, MARKING, edge)
            colours = _over(colours, MARKING, between * (dash / _STEPS))
            colours = _over(colours, MARKING, posts * has_post)
            columns.append(_over(colours, MARKING, 0.8 * centre * has_dot))
        columns.append(np.broadcast_to(np.asarray(GROUND, np.float64), (across.size, 3)))
        red, green, blue = np.moveaxis(np.rint(np.stack(columns, axis=1)).astype(np.uint32), -1, 0)
        return np.ascontiguousarray(red << 16 | green << 8 | blue)

    def _band(self, across: FloatArray, low: float, high: float) -> FloatArray:
        """Share of a pixel within low to high."""
        lower = np.clip((across - low) * self._scale + 0.5, 0.0, 1.0)
        upper = np.clip((high - across) * self._scale + 0.5, 0.0, 1.0)
        return np.asarray(np.maximum(lower + upper - 1.0, 0.0))

    def _stroke(self, across: FloatArray, middle: float, width: float) -> FloatArray:
        half = 0.5 * max(width, _MIN_PIXELS / self._scale)
        return self._band(across, middle - half, middle + half)

    def _blend(
        self,
        pixels: NDArray[np.uint32],
        along: FloatArray,
        across: FloatArray,
        gap: Gap,
    ) -> None:
        """Colour the gap's band in a block of pixels with these places on the road."""
        if pixels.size == 0:
            return
        low, high = gap.lane * self._road.lane_width, (gap.lane + 1) * self._road.lane_width
        inset = _INSET * self._road.lane_width
        cover = self._band(across, low + inset, high - inset)
        cover = cover * self._band(along, gap.rear, gap.front)
        if gap.is_hatched:
            slanted = (along + across) / _HATCH
            distance = np.abs(slanted - np.rint(slanted)) * (_HATCH * math.sqrt(0.5) * self._scale)
            stroke = np.clip(0.5 * _STROKE * self._scale - distance + 0.5, 0.0, 1.0)
            cover = cover * (_HATCH_GROUND + (_HATCH_STROKE - _HATCH_GROUND) * stroke)
        else:
            cover = cover * _PLAIN
        marks = self._cover_distances(gap, along, across - 0.5 * (low + high))
        blended = np.zeros_like(pixels)
        for shift, value, mark in zip((16, 8, 0), gap.colour, MARKING, strict=True):
            channel = (pixels >> shift & 0xFF).astype(np.float32)
            channel += (value - channel) * cover
            channel += (mark - channel) * marks
            blended |= channel.astype(np.uint32) << shift
        pixels[:] = blended

    def _cover_distances(self, gap: Gap, along: FloatArray, across: FloatArray) -> FloatArray:
        """Share of a pixel that lines along the lane cover, with strokes across at their ends."""
        half = 0.5 * max(_LINE_WIDTH, _MIN_PIXELS / self._scale)
        reach = _END_STROKE * self._road.lane_width
        line, stroke = self._band(across, -half, half), self._band(across, -reach, reach)
        cover = np.zeros(np.broadcast_shapes(along.shape, across.shape), np.float32)
        for start, end in gap.distances:
            np.maximum(cover, line * self._band(along, start, end), out=cover)
            for place in (start + half, end - half):
                np.maximum(cover, stroke * self._band(along, place - half, place + half), out=cover)
        return cover

    def _bound(self, gap: Gap) -> tuple[slice, slice]:
        """Rows and columns of the smallest block of pixels that holds the gap."""
        camera, width = self._camera, self._road.lane_width
        places = np.linspace(max(gap.rear, camera.reach[0]), min(gap.front, camera.reach[1]), 64)
        found = [camera.place(places, (gap.lane + side) * width) for side in (0, 1)]
        slices = []
        for axis, size in ((1, camera.size[1]), (0, camera.size[0])):
            values = np.concatenate([one[axis] for one in found])
            first, last = math.floor(values.min()) - 2, math.ceil(values.max()) + 2
            slices.append(slice(min(max(first, 0), size), min(max(last, 0), size)))
        return slices[0], slices[1]


def _over(below: FloatArray, colour: Colour, cover: FloatArray) -> FloatArray:
    return np.asarray(below + (np.asarray(colour) - below) * cover[:, None])
