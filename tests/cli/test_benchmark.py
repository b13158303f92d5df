"""The commands of the benchmark."""

import sys

import pytest
from cli.commands import assert_refused, files

from marl_lanes.cli.main import main
from marl_lanes.evaluation.benchmark_tables import BEGIN, END, format_markdown, read_rows

QUICK = ["--maneuvers", "2", "--seed", "1"]


@pytest.mark.slow
@pytest.mark.usefixtures("small_zoo")
def test_a_policy_is_measured_where_it_fits(capsys, tmp_path, monkeypatch):
    monkeypatch.setattr("marl_lanes.cli.benchmark.TASKS", ("interactive", "adversarial"))
    file = tmp_path / "rows.json"
    assert main(["benchmark", "zoo:paper", *QUICK, "--label", "mine", "--json", str(file)]) == 0
    text = capsys.readouterr().out
    assert text.startswith("mine; 2 maneuvers of each task, seed 1")
    assert "interactive: does not fit: checkpoint zoo:paper: its features are" in text
    rows = read_rows(file)
    assert [row.task for row in rows] == ["interactive", "adversarial"]
    assert [row.does_not_fit is None for row in rows] == [False, True]
    assert {row.policy for row in rows} == {"mine"}
    assert {row.training.transitions for row in rows if row.training} == {1234}
    assert main(["benchmark-table", str(file), str(file)]) == 0
    assert capsys.readouterr().out == format_markdown(rows * 2) + "\n"
    page = tmp_path / "page.md"
    page.write_text(f"{BEGIN}{END}", encoding="utf-8")
    assert main(["benchmark-table", str(file), "--page", str(page)]) == 0
    assert capsys.readouterr().out == ""
    assert format_markdown(rows) in page.read_text(encoding="utf-8")


@pytest.mark.slow
def test_a_function_of_the_user_is_measured(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "own_benchmark.py").write_text(
        "import numpy as np\n"
        "def keep(scenario):\n"
        "    if scenario.name != 'adversarial':\n"
        "        raise ValueError(f'not for {scenario.name}')\n"
        "    return lambda seen: np.zeros((len(seen), 1))\n",
        encoding="utf-8",
    )
    try:
        assert main(["benchmark", "own_benchmark:keep", *QUICK]) == 0
        text = capsys.readouterr().out
        assert "paper: does not fit: policy own_benchmark:keep: ValueError: not for paper" in text
        assert "adversarial: no cost ratio: no maneuver was completed" in text
        command = ["benchmark", "own_benchmark:keep", "--task", "adversarial", "paper", *QUICK]
        assert_refused(capsys, tmp_path, command, "not for paper")
    finally:
        sys.modules.pop("own_benchmark", None)


@pytest.mark.usefixtures("small_zoo")
def test_a_named_task_must_fit(capsys, tmp_path):
    command = ["benchmark", "zoo:paper", "--task", "paper", "interactive", *QUICK]
    assert_refused(capsys, tmp_path, command, "checkpoint zoo:paper: its features are")
    # A follower's policy fits none.
    command = ["benchmark", "zoo:adversary", *QUICK]
    assert_refused(capsys, tmp_path, command, "checkpoint zoo:adversary: its features are")


def test_a_bad_page_or_file_is_refused(capsys, tmp_path):
    (tmp_path / "rows.json").write_text("[]", encoding="utf-8")
    (tmp_path / "page.md").write_text("text", encoding="utf-8")
    rows, page = str(tmp_path / "rows.json"), str(tmp_path / "page.md")
    assert_refused(capsys, tmp_path, ["benchmark-table", rows, "--page", page], "must have the")
    assert_refused(capsys, tmp_path, ["benchmark-table", page], "page.md: Invalid JSON")
    assert_refused(capsys, tmp_path, ["benchmark-table", rows, "--page", rows], "it is read, too")
    assert files(tmp_path) == {"rows.json", "page.md"}
