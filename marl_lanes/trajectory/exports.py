"""Trajectories for other programs: CSV, and SUMO's floating car data (FCD)."""

import math
from pathlib import Path
from xml.sax.saxutils import XMLGenerator
from xml.sax.xmlreader import AttributesImpl

import numpy as np

from marl_lanes.extras import need
from marl_lanes.files import replacing
from marl_lanes.trajectory.file import Trajectory, make_table
from marl_lanes.trajectory.frames import Frame, Rows
from marl_lanes.trajectory.metadata import TrajectoryError
from marl_lanes.trajectory.road_line import RoadLine
from marl_lanes.trajectory.signals import are_braking, are_commanded, find_indicators

_FCD_SCHEMA = "http://sumo.dlr.de/xsd/fcd_file.xsd"
_RIGHT, _LEFT = 1, 2
"""Bits of SUMO's signals for the blinkers."""
_BRAKE = 8
"""Bit of SUMO's signals for the brake lights."""


def write_csv(path: Path, trajectory: Trajectory) -> None:
    """Write the columns as a CSV file: one header line, empty cells for missing values.

    Raises:
        MissingExtraError: pyarrow is not installed.
        OSError: the file cannot be written.
    """
    csv = need("pyarrow.csv", "view")
    table = make_table(trajectory.metadata, trajectory.rows)
    with replacing(path) as temporary, temporary.open("wb") as file:
        csv.write_csv(table, file)


def write_fcd(path: Path, trajectory: Trajectory, road: int | None = None) -> None:
    """Write one road as SUMO's floating car data, an XML file.

    A timestep for each step, a vehicle element for each vehicle: x and y of the front bumper's
    middle, angle (clockwise from north), speed, pos (of the front bumper along the road), lane as
    ``road_LANE``, acceleration, signals (blinkers of changers, brake lights), and type: the
    driver's profile, or ``changer`` for one with a command.

    Args:
        path: of the file.
        trajectory: with the road.
        road: its index; None if the trajectory has one road.

    Raises:
        TrajectoryError: it has no such road, or several.
        OSError: the file cannot be written.

    Source: https://sumo.dlr.de/docs/Simulation/Output/FCDOutput.html
    """
    roads = trajectory.roads
    if road is None:
        if len(roads) != 1:
            raise TrajectoryError(f"road = None: must be one of {roads}: FCD has one road")
        (road,) = roads
    line = RoadLine(trajectory.scenario)
    with replacing(path) as temporary, temporary.open("w", encoding="utf-8", newline="\n") as file:
        xml = XMLGenerator(file, "utf-8", short_empty_elements=True)
        xml.startDocument()
        xml.startElement(
            "fcd-export",
            AttributesImpl(
                {
                    "xmlns:xsi": "http://www.w3.org/2001/XMLSchema-instance",
                    "xsi:noNamespaceSchemaLocation": _FCD_SCHEMA,
                }
            ),
        )
        for frame in trajectory.frames(road):
            xml.characters("\n")
            xml.startElement("timestep", AttributesImpl({"time": f"{frame.time:.3f}"}))
            for attributes in _vehicles(frame, line):
                xml.characters("\n  ")
                xml.startElement("vehicle", AttributesImpl(attributes))
                xml.endElement("vehicle")
            xml.endElement("timestep")
        xml.endElement("fcd-export")
        xml.endDocument()


def _vehicles(frame: Frame, line: RoadLine) -> list[dict[str, str]]:
    rows = frame.rows
    half = 0.5 * rows["length"]
    x, y, heading = line.place(rows["position"], rows["lateral_position"])
    heading = heading + rows["yaw"]
    angle = (90.0 - np.degrees(heading)) % 360.0
    ahead = rows["position"] + half * np.cos(rows["yaw"])
    profiles = tuple(frame.scenario.drivers.profiles)
    lane = np.floor(rows["lateral_position"] / frame.scenario.road.lane_width)
    lane = np.clip(lane, 0, frame.scenario.road.num_lanes - 1)
    is_changer, signals = are_commanded(rows), _find_signals(rows)
    found = []
    for index, row in enumerate(rows):
        found.append(
            {
                "id": str(row["vehicle"]),
                "x": f"{x[index] + half[index] * math.cos(heading[index]):.3f}",
                "y": f"{y[index] + half[index] * math.sin(heading[index]):.3f}",
                "angle": f"{angle[index]:.3f}",
                "type": "changer" if is_changer[index] else profiles[row["profile"]],
                "speed": f"{row['speed']:.3f}",
                "pos": f"{ahead[index]:.3f}",
                "lane": f"road_{int(lane[index])}",
                "signals": str(signals[index]),
                "acceleration": f"{row['acceleration']:.3f}",
            }
        )
    return found


def _find_signals(rows: Rows) -> list[int]:
    side = find_indicators(rows)
    blinkers = np.select([side > 0, side < 0], [_LEFT, _RIGHT], 0)
    return [int(one) for one in blinkers | np.where(are_braking(rows), _BRAKE, 0)]
