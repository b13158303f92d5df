import csv
import importlib.util
import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import recordings
import sumolib

from marl_lanes.trajectory.exports import write_csv, write_fcd
from marl_lanes.trajectory.metadata import TrajectoryError
from marl_lanes.trajectory.road_line import RoadLine

pytestmark = pytest.mark.slow


def read_fcd(path):
    """By SUMO's own reader: time to vehicles."""
    return {
        float(timestep.time): list(timestep.vehicle or ())
        for timestep in sumolib.xml.parse(str(path), "timestep")
    }


@pytest.fixture(scope="module")
def fcd(tmp_path_factory):
    path = tmp_path_factory.mktemp("exports") / "paper.fcd.xml"
    write_fcd(path, recordings.paper())
    return path


def test_sumo_reads_every_step_and_vehicle(fcd):
    trajectory = recordings.paper()
    found = read_fcd(fcd)
    frames = list(trajectory.frames(0))
    assert sorted(found) == pytest.approx([frame.time for frame in frames])
    for frame in frames[::40]:
        vehicles = found[round(frame.time, 2)]
        assert [int(one.id) for one in vehicles] == frame.rows["vehicle"].tolist()
        speeds = [float(one.speed) for one in vehicles]
        assert speeds == pytest.approx(frame.rows["speed"].tolist(), abs=6e-4)


def test_positions_are_those_of_the_front_bumper(tmp_path):
    trajectory = recordings.record("curved", 60)
    write_fcd(tmp_path / "curved.fcd.xml", trajectory)
    frame = list(trajectory.frames(0))[-1]
    line, half = RoadLine(trajectory.scenario), 0.5 * trajectory.scenario.vehicle.length
    for one, row in zip(read_fcd(tmp_path / "curved.fcd.xml")[6.0], frame.rows, strict=True):
        angle = math.radians(90.0 - float(one.angle))
        x, y, heading = line.place(row["position"], row["lateral_position"])
        assert math.remainder(angle - heading - row["yaw"], math.tau) == pytest.approx(0, abs=1e-4)
        assert float(one.x) - half * math.cos(angle) == pytest.approx(x, abs=2e-3)
        assert float(one.y) - half * math.sin(angle) == pytest.approx(y, abs=2e-3)


def test_a_changer_shows_its_indicator(fcd):
    rows = recordings.paper().rows
    lit = {1: 1, -1: 2}
    seen = set()
    for time, vehicles in read_fcd(fcd).items():
        for one in vehicles:
            signals = int(one.signals)
            (row,) = rows[(rows["step"] == round(time * 10)) & (rows["vehicle"] == int(one.id))]
            assert bool(signals & 8) == (row["acceleration"] < -0.5)
            if one.type == "changer" and row["outcome"] == 0 and row["phase"] != 3:
                # SUMO's bit 0 is the right blinker, bit 1 the left one.
                assert signals & 3 == lit[-row["direction"]]
                seen.add(int(row["direction"]))
            elif one.type != "changer":
                assert signals & 3 == 0
    assert seen == {1, -1}


@pytest.mark.skipif(
    importlib.util.find_spec("sumo") is None, reason="eclipse-sumo is the extra sumo"
)
def test_sumos_own_tools_read_it(fcd, tmp_path):
    import sumo

    home = Path(sumo.SUMO_HOME)
    table = tmp_path / "fcd.csv"
    subprocess.run(
        [sys.executable, home / "tools" / "xml" / "xml2csv.py", fcd, "-o", table], check=True
    )
    with table.open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file, delimiter=";"))
    assert len(rows) == recordings.paper().rows.size
    import lxml.etree

    schema = lxml.etree.XMLSchema(lxml.etree.parse(home / "data" / "xsd" / "fcd_file.xsd"))
    schema.assertValid(lxml.etree.parse(fcd))


def test_one_of_several_roads_has_to_be_chosen(tmp_path):
    trajectory = recordings.crashes()
    with pytest.raises(TrajectoryError, match=r"road = None: must be one of \[0, 1, 2"):
        write_fcd(tmp_path / "many.xml", trajectory)
    write_fcd(tmp_path / "one.xml", trajectory, road=2)
    found = read_fcd(tmp_path / "one.xml")
    assert sum(map(len, found.values())) == trajectory.rows_of(2).size


def test_csv_has_a_header_and_empty_cells(tmp_path):
    trajectory = recordings.paper()
    write_csv(tmp_path / "paper.csv", trajectory)
    with (tmp_path / "paper.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == trajectory.rows.size
    speeds = np.asarray([float(row["speed"]) for row in rows], np.float32)
    assert (speeds == trajectory.rows["speed"]).all()
    empty = sum(row["command"] == "" for row in rows)
    assert empty == (trajectory.rows["command"] == -1).sum()
    assert {row["phase"] for row in rows} >= {"absent", "engaged"}


def test_a_trucks_front_bumper_is_further_ahead(tmp_path):
    trajectory = recordings.record("trucks", 5, seed=2)
    write_fcd(tmp_path / "trucks.fcd.xml", trajectory)
    frame = list(trajectory.frames(0))[-1]
    half = {"normal": 2.4, "truck": 8.25}
    seen = set()
    vehicles = read_fcd(tmp_path / "trucks.fcd.xml")[frame.time]
    for one, row in zip(vehicles, frame.rows, strict=True):
        ahead = half[one.type] * math.cos(row["yaw"])
        assert float(one.pos) == pytest.approx(row["position"] + ahead, abs=1e-3)
        seen.add(one.type)
    assert seen == set(half)
