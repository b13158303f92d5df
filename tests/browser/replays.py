"""Recorded traffic with its replay page, and what the page says of itself."""

import math

from marl_lanes.browser.bundle import write_replay
from marl_lanes.browser.optima import find_optima
from marl_lanes.colours import TRAFFIC
from marl_lanes.trajectory.events import find_commands, find_events
from marl_lanes.trajectory.road_line import RoadLine

PIXEL = """([x, y]) => {
    const [r, g, b] = player.canvas.getContext('2d').getImageData(x, y, 1, 1).data;
    return '#' + [r, g, b].map((one) => one.toString(16).padStart(2, '0')).join('');
}"""
"""Colour at a place of the road's picture."""
SEEK = """async (time) => {
    player.clock.pause();
    player.clock.seek(time);
    // The camera may glide for some frames.
    do await new Promise((drawn) => requestAnimationFrame(() => requestAnimationFrame(drawn)));
    while (player.isDirty);
}"""
"""Stop at a time, and wait for its picture."""


class Replay:
    """A trajectory with its page."""

    def __init__(self, folder, trajectory):
        self.trajectory = trajectory
        self.rows = trajectory.rows_of(0)
        self.scenario = trajectory.scenario
        self.commands = find_commands(self.rows)
        self.events = find_events(self.rows)
        path = folder / "replay.html"
        write_replay(path, trajectory, 0, find_optima(self.rows, self.scenario))
        self.address = path.as_uri()

    def at(self, step):
        return self.rows[self.rows["step"] == step]

    def row(self, vehicle, step):
        (row,) = self.at(step)[self.at(step)["vehicle"] == vehicle]
        return row

    @property
    def completed(self):
        return next(one for one in self.commands if one.outcome.name == "COMPLETED")


def project(replay, rows, view):
    """Pixels of the rows' centres, computed here from what the camera says of itself."""
    line, road = RoadLine(replay.scenario), replay.scenario.road
    x, y, _ = line.place(rows["position"], rows["lateral_position"])
    middle = 0.5 * road.num_lanes * road.lane_width
    x0, y0, heading = line.place(view["position"], middle)
    cosine, sine = math.cos(heading), math.sin(heading)
    right = (x - x0) * cosine + (y - y0) * sine
    up = (y - y0) * cosine - (x - x0) * sine
    return view["width"] / 2 + view["scale"] * right, view["height"] / 2 - view["scale"] * up


def view_of(page):
    return page.evaluate(
        "({position: player.camera.position, scale: player.camera.scale, "
        "width: player.camera.width, height: player.camera.height})"
    )


def time_of(page):
    return page.evaluate("player.clock.time")


def check_cars(replay, page, step):
    """The colours at the centres of all vehicles in view; the number of changers among them."""
    page.evaluate(SEEK, step * replay.scenario.time_step)
    view, rows = view_of(page), replay.at(step)
    xs, ys = project(replay, rows, view)
    changers = 0
    for row, x, y in zip(rows, xs, ys, strict=True):
        if 20 < x < view["width"] - 120 and 20 < y < view["height"] - 20:
            is_changer = row["command"] >= 0
            expected = TRAFFIC.changer if is_changer else TRAFFIC.vehicle
            assert page.evaluate(PIXEL, [float(x), float(y)]) == expected, row["vehicle"]
            changers += is_changer
    return changers
