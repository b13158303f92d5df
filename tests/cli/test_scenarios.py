"""The commands on scenarios: the list, all fields of one, what is wrong with one, the schema."""

import json
import sys

import pytest
import yaml
from cli.commands import EVALUATE, assert_refused
from packaging.version import Version
from pydantic import VERSION
from scenario.breakages import as_yaml, breakages, fields_with

from marl_lanes import list_scenarios, load_scenario
from marl_lanes.cli.main import main
from marl_lanes.scenario.json_schema import FILE
from marl_lanes.traffic.roles.external import _registered


def test_every_scenario_is_listed(capsys):
    assert main(["scenarios"]) == 0
    captured = capsys.readouterr()
    rows = captured.out.splitlines()
    assert [row.split()[0] for row in rows] == list_scenarios()
    for row, name in zip(rows, list_scenarios(), strict=True):
        assert row.endswith(load_scenario(name).description)
    assert captured.err == ""
    assert main(["scenarios", "--json", "-"]) == 0
    listed = json.loads(capsys.readouterr().out)
    assert [one["name"] for one in listed] == list_scenarios()
    assert listed[0]["description"] == load_scenario(list_scenarios()[0]).description


@pytest.mark.parametrize("name", list_scenarios())
def test_a_printed_scenario_is_the_scenario(capsys, tmp_path, name):
    assert main(["show", name]) == 0
    text = capsys.readouterr().out
    assert load_scenario(yaml.safe_load(text)) == load_scenario(name)
    file = tmp_path / "printed.yaml"
    file.write_text(text, encoding="utf-8")
    assert load_scenario(file) == load_scenario(name)
    assert main(["show", str(file)]) == 0
    assert capsys.readouterr().out == text
    assert main(["show", name, "--json", str(tmp_path / "shown.json")]) == 0
    assert capsys.readouterr().out == text
    assert json.loads((tmp_path / "shown.json").read_text(encoding="utf-8")) == yaml.safe_load(text)


@pytest.mark.parametrize(
    ("name", "message"),
    [("papier", "scenario 'papier': no such scenario"), ("absent.yaml", "absent.yaml")],
)
def test_another_scenario_is_refused(capsys, tmp_path, monkeypatch, name, message):
    monkeypatch.chdir(tmp_path)
    assert_refused(capsys, tmp_path, ["show", name], message)


@pytest.mark.parametrize(("command", "stride"), [(["show"], 97), ([*EVALUATE, "--scenario"], 397)])
def test_a_broken_scenario_is_refused_in_one_line(capsys, tmp_path, command, stride):
    file = tmp_path / "broken.yaml"
    for path, value in breakages()[::stride]:
        file.write_text(as_yaml(fields_with(path, value)), encoding="utf-8")
        assert_refused(capsys, tmp_path, [*command, str(file)], path[0])


FILES = {
    "good.yaml": "num_agents: 3\n",
    "typo.yaml": "num_agent: 3\n",
    "together.yaml": "{time_step: 0.5, lane_keeping: {pole: 3.0}}\n",
    "mine.yaml": "followers: {mix: {mine: 1.0}}\n",
    "learns.yaml": "followers: {mix: {learned: 1.0}}\n",
    "gone.yaml": "followers: {mix: {learned: 1.0}, learned: {checkpoint: gone.pt}}\n",
    "my_own.py": "from marl_lanes import register_follower\nregister_follower('mine', len)\n",
}
PROBLEMS = {
    "typo.yaml": "num_agent: unknown key; did you mean num_agents?",
    "together.yaml": "lane_keeping",
    "mine.yaml": "followers.mix: 'mine' has no policy",
    "gone.yaml": "gone.pt: cannot be read",
    "absent.yaml": "absent.yaml: cannot be read",
    "papier": "'papier': no such scenario",
}


@pytest.fixture
def written(tmp_path, monkeypatch):
    """Scenarios, good and bad, and a module that registers a follower."""
    monkeypatch.chdir(tmp_path)
    for name, text in FILES.items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    yield tmp_path
    sys.modules.pop("my_own", None)
    _registered.pop("mine", None)


@pytest.mark.usefixtures("written")
def test_valid_scenarios_are_valid(capsys):
    names = ["paper", "good.yaml", "learns.yaml", "mine.yaml"]
    assert main(["validate", *names, "--import", "my_own"]) == 0
    assert capsys.readouterr().out.splitlines() == [f"{name}: is valid" for name in names]


@pytest.mark.usefixtures("written")
def test_what_is_wrong_with_a_scenario_is_a_line_and_the_status_1(capsys):
    assert main(["validate", "paper", *PROBLEMS]) == 1
    first, *lines = capsys.readouterr().out.splitlines()
    assert first == "paper: is valid"
    for (name, problem), line in zip(PROBLEMS.items(), lines, strict=True):
        assert line.startswith(f"{name}: is not valid: ")
        assert problem in line
    assert main(["validate", "paper", *PROBLEMS, "--json", "-"]) == 1
    found = json.loads(capsys.readouterr().out)
    assert [one["scenario"] for one in found] == ["paper", *PROBLEMS]
    assert [one["is_valid"] for one in found] == [True] + [False] * len(PROBLEMS)
    told = [f"{one['scenario']}: is not valid: {one['problem']}" for one in found[1:]]
    assert (found[0]["problem"], told) == (None, lines)


@pytest.mark.skipif(Version(VERSION) < Version("2.10"), reason="says less of a map's keys")
def test_the_printed_schema_is_the_file_that_ships(capsys):
    assert main(["schema"]) == 0
    assert capsys.readouterr().out == FILE.read_text(encoding="utf-8")
