"""The command that lists and prints scenarios."""

import pytest
import yaml
from cli.commands import EVALUATE, assert_refused
from scenario.breakages import as_yaml, breakages, fields_with

from marl_lanes import list_scenarios, load_scenario
from marl_lanes.cli.main import main


def test_every_scenario_is_listed(capsys):
    assert main(["scenarios"]) == 0
    captured = capsys.readouterr()
    rows = captured.out.splitlines()
    assert [row.split()[0] for row in rows] == list_scenarios()
    for row, name in zip(rows, list_scenarios(), strict=True):
        assert row.endswith(load_scenario(name).description)
    assert captured.err == ""


@pytest.mark.parametrize("name", list_scenarios())
def test_a_printed_scenario_is_the_scenario(capsys, tmp_path, name):
    assert main(["scenarios", name]) == 0
    text = capsys.readouterr().out
    assert load_scenario(yaml.safe_load(text)) == load_scenario(name)
    file = tmp_path / "printed.yaml"
    file.write_text(text, encoding="utf-8")
    assert load_scenario(file) == load_scenario(name)
    assert main(["scenarios", str(file)]) == 0
    assert capsys.readouterr().out == text


@pytest.mark.parametrize(
    ("name", "message"),
    [("papier", "scenario 'papier': no such scenario"), ("absent.yaml", "absent.yaml")],
)
def test_another_scenario_is_refused(capsys, tmp_path, monkeypatch, name, message):
    monkeypatch.chdir(tmp_path)
    assert_refused(capsys, tmp_path, ["scenarios", name], message)


@pytest.mark.parametrize(
    ("command", "stride"), [(["scenarios"], 97), ([*EVALUATE, "--scenario"], 397)]
)
def test_a_broken_scenario_is_refused_in_one_line(capsys, tmp_path, command, stride):
    file = tmp_path / "broken.yaml"
    for path, value in breakages()[::stride]:
        file.write_text(as_yaml(fields_with(path, value)), encoding="utf-8")
        assert_refused(capsys, tmp_path, [*command, str(file)], path[0])
