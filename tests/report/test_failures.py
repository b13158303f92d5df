"""What went wrong: the table's rows, the counts, the warnings, the commands."""

import shlex

import pytest
from report.runs import ROWS, add_replays, make_run, row

from marl_lanes.report.failures import (
    count_kinds,
    describe_replays,
    find_warnings,
    list_failures,
)
from marl_lanes.report.run_files import read_run


def test_every_failed_maneuver_is_listed_with_its_replay_where_there_is_one(tmp_path):
    run = make_run(tmp_path / "run", rows=ROWS[::-1])
    add_replays(run, 1)
    failures = list_failures(read_run(run))
    assert [(one.maneuver.road, one.maneuver.command, one.replay) for one in failures] == [
        (0, 1, None),
        (1, 0, "replays/road_0001.html#command=0"),
    ]
    assert count_kinds(failures) == [("failed after completion", 1), ("missed", 1)]


def warnings(tmp_path, rows, **options):
    return find_warnings(read_run(make_run(tmp_path / "run", rows=rows, **options)))


def test_a_good_run_has_no_warning(tmp_path):
    rows = [row(road, 0) for road in range(20)]
    assert warnings(tmp_path, rows, choice="step_000000200.pt") == []


@pytest.mark.parametrize(
    ("num_failed", "start"),
    [(1, None), (2, "2 of 20 lane changes fail"), (11, "Most lane"), (20, "Every lane")],
)
def test_low_success_is_said_in_words(tmp_path, num_failed, start):
    rows = [
        row(index, 0, *(("missed", "late") if index < num_failed else ())) for index in range(20)
    ]
    found = warnings(tmp_path, rows)
    assert [text.startswith(start) for text in found] == ([True] if start else [])


def test_dangers_are_named(tmp_path):
    rows = [row(index, 0) for index in range(97)]
    rows += [
        row(1, 1, "collision", "collided while changing lanes"),
        row(1, 2, "off_road", "left the road"),
        row(1, 3, "completed", "lost"),
    ]
    assert [text.partition(" ")[0] for text in warnings(tmp_path, rows)] == ["One"] * 3
    assert "the success rate does not" in warnings(tmp_path / "again", rows)[2]


def test_an_untrained_choice_and_a_single_road(tmp_path):
    found = warnings(tmp_path, [row(0, 0), row(0, 1)], choice="step_000000000.pt")
    assert ["untrained" in found[0], "one road" in found[1], len(found)] == [True, True, 2]


def test_intervals_over_few_roads_are_doubted(tmp_path):
    (found,) = warnings(tmp_path, [row(road, 0) for road in range(19)])
    assert "on 19 roads alone" in found


def test_the_commands_can_be_given_to_a_shell(tmp_path):
    run = read_run(make_run(tmp_path / "a run"))
    record, replay, report = map(shlex.split, describe_replays(run, 17))
    folder = tmp_path / "a run"
    road = str(folder / "trajectories" / "road_0017.parquet")
    assert record == [
        *("marl-lanes", "record", str(folder / "checkpoints" / "final.pt")),
        *("--scenario", str(folder / "scenario.yaml")),
        *("--seed", "1000000", "--road", "17", "--out", road),
    ]
    assert replay == [
        *("marl-lanes", "replay", road, "--out", str(folder / "replays" / "road_0017.html")),
    ]
    assert report == ["marl-lanes", "report", str(folder)]
