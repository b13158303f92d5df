"""The ground from above: road, markings, verge, and the gap that the rule looks at."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from marl_lanes.colours import DARK, TRAFFIC
from marl_lanes.rendering.camera import Camera
from marl_lanes.rendering.loading import pygame
from marl_lanes.rendering.palette import Colour, mix, to_rgb
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

_HATCH = 2.4
"""[m] Between two strokes of a hatched gap."""

ROAD = to_rgb(TRAFFIC.road)
MARKING = to_rgb(TRAFFIC.marking)
GROUND = to_rgb(DARK.ground)


class Gap(NamedTuple):
    """The gap in the target lane, drawn as a band."""

    lane: int
    rear: float
    """Front bumper of the target follower [m]; where there is none, the picture's edge or less."""
    front: float
    """Rear bumper of the target leader [m]."""
    colour: Colour
    is_hatched: bool


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
        reach = camera.size[1] / self._scale
        self._lowest = -reach
        self._num_rows = int((2.0 * reach + camera.road_width) * self._scale * _STEPS)

    def draw(self, surface: "pygame.Surface", target_lane: int | None, gap: Gap | None) -> None:
        """Draw the ground.

        Args:
            surface: of the camera's size, 32 bits a pixel.
            target_lane: whose centre is dotted.
            gap: to be shown.
        """
        position, lateral_position = self._camera.look_up()
        rows = ((lateral_position - self._lowest) * (self._scale * _STEPS)).astype(np.int32)
        np.clip(rows, 0, self._num_rows - 1, out=rows)
        start = float(position.min())
        columns_of = self._classify(start, float(position.max()))
        columns = columns_of[((position - start) * (self._scale * 4.0)).astype(np.int32)]
        table = self._table(target_lane)
        pixels = pygame.surfarray.pixels2d(surface).T
        if rows.shape[1] == 1:
            pixels[:] = table[rows[:, 0]][:, columns[0]]
        else:
            rows *= table.shape[1]
            rows += columns
            pixels[:] = table.ravel()[rows]
        if gap is not None:
            self._blend(pixels, position, lateral_position, gap)

    def _classify(self, start: float, end: float) -> NDArray[np.int32]:
        """What is at positions from start to end, each quarter of a pixel: a column of the table.

        The column is dash + 9 (post + 2 (stripe + 2 dot)), or the last beyond the road's ends.
        """
        count = int((end - start) * self._scale * 4.0) + 2
        place = start + (np.arange(count) + 0.5) / (4.0 * self._scale)
        dash = self._cover(place, DASH_PERIOD, 0.5 * DASH_LENGTH)
        dash_level = np.rint(dash * _STEPS).astype(np.int32)
        half_post = 0.5 * max(_POST_WIDTH, 2.0 / self._scale)
        post = self._cover(place, POST_SPACING, half_post) > 0.5
        stripe = np.floor(place / _STRIPE).astype(np.int32) % 2
        dot = self._cover(place, 3.0, 0.5) > 0.5
        columns = dash_level + (_STEPS + 1) * (post + 2 * (stripe + 2 * dot))
        is_outside = (place < 0.0) | (place > self._road.length)
        return np.where(is_outside, 8 * (_STEPS + 1), columns).astype(np.int32)

    def _cover(self, place: NDArray[np.float64], period: float, half: float) -> NDArray[np.float64]:
        """Share of a pixel that marks around the multiples of a period cover."""
        distance = np.abs(place - period * np.rint(place / period))
        return np.clip((half - distance) * self._scale + 0.5, 0.0, 1.0)

    def _table(self, target_lane: int | None) -> NDArray[np.uint32]:
        """(rows, columns) colours as 0xrrggbb."""
        if target_lane not in self._tables:
            self._tables[target_lane] = self._make_table(target_lane)
        return self._tables[target_lane]

    def _make_table(self, target_lane: int | None) -> NDArray[np.uint32]:
        road, width = self._road, self._camera.road_width
        across = self._lowest + (np.arange(self._num_rows) + 0.5) / (self._scale * _STEPS)
        paved = self._band(across, -_PAVED, width + _PAVED)
        edge = self._stroke(across, -0.5 * _EDGE_WIDTH, _EDGE_WIDTH)
        edge += self._stroke(across, width + 0.5 * _EDGE_WIDTH, _EDGE_WIDTH)
        between = sum(
            self._stroke(across, lane * road.lane_width, _LINE_WIDTH)
            for lane in range(1, road.num_lanes)
        )
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
            colours = np.broadcast_to(np.asarray(ground, np.float64), (across.size, 3))
            colours = _over(colours, ROAD, paved)
            colours = _over(colours, MARKING, edge)
            colours = _over(colours, MARKING, between * (dash / _STEPS))
            colours = _over(colours, MARKING, posts * has_post)
            columns.append(_over(colours, MARKING, 0.8 * centre * has_dot))
        columns.append(np.broadcast_to(np.asarray(GROUND, np.float64), (across.size, 3)))
        packed = np.rint(np.stack(columns, axis=1)).astype(np.uint32)
        return packed[..., 0] << 16 | packed[..., 1] << 8 | packed[..., 2]

    def _band(self, across: NDArray[np.float64], low: float, high: float) -> NDArray[np.float64]:
        """Share of a pixel within low to high."""
        lower = np.clip((across - low) * self._scale + 0.5, 0.0, 1.0)
        return lower + np.clip((high - across) * self._scale + 0.5, 0.0, 1.0) - 1.0

    def _stroke(
        self, across: NDArray[np.float64], middle: float, width: float
    ) -> NDArray[np.float64]:
        half = 0.5 * max(width, _MIN_PIXELS / self._scale)
        return self._band(across, middle - half, middle + half)

    def _blend(
        self,
        pixels: NDArray[np.uint32],
        position: NDArray[np.float32],
        lateral_position: NDArray[np.float32],
        gap: Gap,
    ) -> None:
        """Colour the gap's band, within the smallest rectangle that holds it."""
        low = gap.lane * self._road.lane_width
        is_along = (position > gap.rear) & (position < gap.front)
        is_across = (lateral_position > low) & (lateral_position < low + self._road.lane_width)
        is_inside = is_along & is_across
        rows, columns = np.flatnonzero(is_inside.any(1)), np.flatnonzero(is_inside.any(0))
        if rows.size == 0:
            return
        tall, wide = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
        along = position[tall if position.shape[0] > 1 else slice(None), wide]
        across = lateral_position[tall, wide if lateral_position.shape[1] > 1 else slice(None)]
        inner = 0.12 * self._road.lane_width
        cover = np.clip((across - low - inner) * self._scale + 0.5, 0.0, 1.0)
        cover = cover * np.clip(
            (low + self._road.lane_width - inner - across) * self._scale + 0.5, 0.0, 1.0
        )
        cover = cover * ((along > gap.rear) & (along < gap.front))
        if gap.is_hatched:
            slanted = (along + across) / _HATCH
            distance = np.abs(slanted - np.rint(slanted)) * (_HATCH * self._scale * 0.7)
            stroke = np.clip(0.2 * _HATCH * self._scale - distance + 0.5, 0.0, 1.0)
            cover = cover * (0.25 + 0.6 * stroke)
        else:
            cover = cover * 0.55
        block = pixels[tall, wide]
        blended = np.zeros_like(block)
        for shift, value in zip((16, 8, 0), gap.colour, strict=True):
            channel = (block >> shift & 0xFF).astype(np.float32)
            channel += (value - channel) * cover
            blended |= channel.astype(np.uint32) << shift
        pixels[tall, wide] = blended


def _over(
    below: NDArray[np.float64], colour: Colour, cover: NDArray[np.float64]
) -> NDArray[np.float64]:
    return np.asarray(below + (np.asarray(colour) - below) * cover[:, None])
