"""Rows of the benchmark: their file, and the tables that show them."""

import json

import pytest

from marl_lanes.evaluation.benchmark import ENDINGS, MEANS, Row, Training
from marl_lanes.evaluation.benchmark_tables import (
    BEGIN,
    END,
    BenchmarkError,
    dump_rows,
    format_markdown,
    format_rows,
    read_rows,
    write_page,
)
from marl_lanes.evaluation.intervals import Estimate
from marl_lanes.files import write_json


def row(policy, task="paper", *, success=0.5, ratio=1.25, **changes):
    statistics = {key: Estimate(0.0, 0.0, 0.25) for key in ENDINGS}
    statistics |= {key: Estimate(2.0, 1.0, 3.0) for key in MEANS}
    statistics["success_rate"] = Estimate(success, 0.25, 1.0)
    statistics["cost_ratio"] = Estimate(ratio, None, None)
    values = {
        "policy": policy,
        "task": task,
        "version": "0.1.0",
        "seed": 3,
        "num_maneuvers": 1000,
        "num_roads": 100,
        "statistics": statistics,
        "decision_microseconds": {1: 100.0, 64: 2.5},
    }
    return Row(**(values | changes))


def unfit(policy, task):
    return Row(policy=policy, task=task, version="0.1.0", seed=3, does_not_fit="other features")


ROWS = [
    row("worse", success=0.5),
    row("dear", success=1.0, ratio=1.5),
    row(
        "cheap",
        success=1.0,
        ratio=1.0,
        training=Training(
            scenario="paper", transitions=12345, demonstrations=2000, seconds=67.8, command=None
        ),
    ),
    unfit("cheap", "dense"),
    row("none", "my|own", success=0.0, ratio=None, no_cost_ratio="no maneuver was completed"),
]


def test_rows_are_read_as_they_were_written(tmp_path):
    write_json(tmp_path / "rows.json", dump_rows(ROWS))
    assert read_rows(tmp_path / "rows.json") == ROWS


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[", "Invalid JSON"),
        ("{}", "Input should be a valid array"),
        ("[{}]", "0.policy: Field required"),
        ('[{"policy": 1}]', "0.policy: Input should be a valid string"),
        ("[]", None),
    ],
)
def test_a_file_without_rows_is_refused_in_one_line(tmp_path, text, message):
    file = tmp_path / "rows.json"
    file.write_text(text, encoding="utf-8")
    if message is None:
        assert read_rows(file) == []
        return
    with pytest.raises(BenchmarkError, match=r"rows\.json: ") as caught:
        read_rows(file)
    assert message in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1


def test_unknown_fields_and_statistics_are_refused(tmp_path):
    file = tmp_path / "rows.json"
    write_json(file, dump_rows(ROWS))
    for change in ({"colour": "red"}, {"statistics": {}}, {"decision_microseconds": {}}):
        rows = json.loads(file.read_text(encoding="utf-8"))
        (tmp_path / "wrong.json").write_text(json.dumps([rows[0] | change]), encoding="utf-8")
        with pytest.raises(BenchmarkError, match=r"wrong\.json: 0"):
            read_rows(tmp_path / "wrong.json")


def test_the_terminal_has_a_column_for_each_task_that_fits():
    text = format_rows([ROWS[2], ROWS[3], ROWS[4]])
    head, *lines = text.splitlines()
    assert head.startswith("cheap; 1000 maneuvers of each task, seed 3")
    assert lines[1].split() == ["paper", "my|own"]
    assert lines[2].split("  ")[0] == "success [%]"
    assert "100.0 [25.0, 100.0]" in lines[2]
    assert lines[3].split() == ["cost", "ratio", "1.000", "-"]
    assert "decision, 64 agents [us]" in text
    assert "dense: does not fit: other features" in text
    assert "my|own: no cost ratio: no maneuver was completed" in text
    assert format_rows([ROWS[3]]) == "dense: does not fit: other features"


def test_the_best_success_comes_first_then_the_lowest_ratio():
    text = format_markdown(ROWS)
    paper, dense, own = (part.partition("\n")[2] for part in text.split("### ")[1:])
    assert text.startswith("### paper\n")
    ended, driven = paper.strip().split("\n\n")
    names = [line.split("|")[1].strip() for line in ended.splitlines()[2:]]
    assert names == ["`cheap`", "`dear`", "`worse`"]
    # Success stands first in both.
    assert [table.splitlines()[0].count("success [%]") for table in (ended, driven)] == [1, 1]
    assert driven.splitlines()[2].endswith("| 100.0 | 2.5 | 12,345 | 2,000 | 68 |")
    assert driven.splitlines()[3].endswith("| - | - | - |")
    assert dense.strip().splitlines()[2].startswith("| `cheap` | does not fit |")
    assert len(dense.strip().splitlines()) == 3
    assert "| `none` | 1,000 | 0.0 [25.0, 100.0] | - |" in own
    for table in (ended, driven):
        assert len({line.count("|") for line in table.splitlines()}) == 1


def test_a_page_gets_the_tables_in_the_place_of_the_old_ones(tmp_path):
    page = tmp_path / "page.md"
    page.write_text(f"# Mine\n\n{BEGIN}\nold\n{END}\nafter\n", encoding="utf-8")
    for _ in range(2):
        write_page(page, ROWS)
        wanted = f"# Mine\n\n{BEGIN}\n\n{format_markdown(ROWS)}\n\n{END}\nafter\n"
        assert page.read_text(encoding="utf-8") == wanted


@pytest.mark.parametrize("text", ["", BEGIN, f"{END} {BEGIN}"])
def test_a_page_without_a_place_is_refused(tmp_path, text):
    page = tmp_path / "page.md"
    page.write_text(text, encoding="utf-8")
    with pytest.raises(BenchmarkError, match=r"page\.md: must have the lines"):
        write_page(page, ROWS)
    assert page.read_text(encoding="utf-8") == text
