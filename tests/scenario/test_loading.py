"""Scenarios by name, from files and mappings, with overrides."""

from pathlib import Path

import pytest
from scenario.refusals import error_of

from marl_lanes.scenario import list_scenarios, load_scenario


def written(tmp_path, text):
    path = tmp_path / "mine.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def test_the_shipped_scenarios_are_listed():
    names = list_scenarios()
    assert names == sorted(names)
    expected = {"paper", "dense", "curved", "cooperative", "adversarial", "touch", "five_lanes"}
    assert expected <= set(names)


def test_overrides_merge_section_by_section():
    scenario = load_scenario("curved", {"road": {"length": 900.0}, "num_agents": None})
    assert scenario.road.length == 900.0
    assert len(scenario.road.arcs) == 2
    assert scenario.num_agents is None
    assert load_scenario("curved").road.length == 1000.0


def test_a_mix_is_replaced_as_a_whole():
    scenario = load_scenario("adversarial", {"followers": {"mix": {"neutral": 1.0}}})
    assert scenario.followers.mix == {"neutral": 1.0}
    scenario = load_scenario("paper", {"drivers": {"mix": {"defensive": 0.5}}})
    assert scenario.drivers.mix == {"defensive": 0.5}


def test_overrides_of_a_scenario_and_of_a_mapping():
    base = load_scenario({"num_slots": 3})
    assert base.name == "custom"
    assert load_scenario(base, {"road": {"num_lanes": 4}}).num_slots == 3
    assert load_scenario({"road": {"num_lanes": 4}}, {"num_slots": 5}).road.num_lanes == 4


@pytest.mark.parametrize("source", ["papr", "PAPER", ""])
def test_an_unknown_name_lists_the_known_ones(source):
    message = error_of(source)
    assert f"scenario {source!r}: no such scenario" in message
    assert ", ".join(list_scenarios()) in message


@pytest.mark.parametrize("kind", [str, Path])
def test_a_missing_file_is_named(tmp_path, kind):
    path = tmp_path / "none.yaml"
    message = error_of(kind(path))
    assert message.startswith(f"scenario file {path}: cannot be read")


@pytest.mark.parametrize("kind", [str, Path])
def test_a_file_is_loaded_under_its_own_name(tmp_path, kind):
    path = written(tmp_path, "road: {num_lanes: 4}\n")
    scenario = load_scenario(kind(path), {"num_slots": 2})
    assert (scenario.name, scenario.road.num_lanes, scenario.num_slots) == ("mine", 4, 2)


@pytest.mark.parametrize("text", ["- 1\n- 2\n", "just text", "", "5"])
def test_a_file_must_hold_a_mapping(tmp_path, text):
    assert "must be a mapping of fields" in error_of(written(tmp_path, text))


@pytest.mark.parametrize(
    ("text", "key"),
    [
        ("num_slots: 3\nnum_slots: 4\n", "num_slots"),
        ("road: {length: 500.0, length: 600.0}\n", "length"),
    ],
)
def test_a_key_written_twice_is_refused(tmp_path, text, key):
    message = error_of(written(tmp_path, text))
    assert f"key '{key}' is written twice" in message
    assert "line" in message


@pytest.mark.parametrize("text", ["road: {length: [}", "a: b: c", "\tx: 1", "road: *nowhere"])
def test_broken_yaml_is_refused(tmp_path, text):
    path = written(tmp_path, text)
    assert error_of(path).startswith(f"scenario file {path}: not readable as YAML")


def test_a_file_that_is_not_text_is_refused(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_bytes(b"\xff\xfe\x00road")
    assert "scenario file" in error_of(path)


@pytest.mark.parametrize(
    "value",
    [
        "!!python/object/apply:pathlib.Path.touch [!!python/object/apply:pathlib.Path [{path}]]",
        "!!python/object/apply:os.mkdir [{path}]",
        "!!python/name:os.system",
    ],
)
def test_yaml_tags_run_no_code(tmp_path, value):
    bait = tmp_path / "bait"
    path = written(tmp_path, "name: " + value.replace("{path}", str(bait)))
    assert "not readable as YAML" in error_of(path)
    assert not bait.exists()


@pytest.mark.parametrize("text", ["? [1, 2]\n: 3\n", "? {a: 1}\n: 3\n", "1: 2\n", "null: 2\n"])
def test_a_key_that_is_not_text_is_refused(tmp_path, text):
    assert "mine.yaml" in error_of(written(tmp_path, text))
