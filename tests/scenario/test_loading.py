"""Scenarios by name, from files and mappings, with overrides."""

import json
from contextlib import suppress
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pytest
from scenario.refusals import error_of
from systems import needs_links

from marl_lanes.scenario import ScenarioError, list_scenarios, load_scenario


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


HASTY = {"profiles": {"aggressive": {"time_headway": 0.5}}, "mix": {"aggressive": 1.0}}
CHANGES = [
    {"drivers": HASTY},
    {"drivers": {"profiles": {"late": {"time_headway": 2.0}}, "mix": {"late": 1.0}}},
    {"followers": {"learned": {"adversarial": {"delay_weight": 0.2}}}},
    {"followers": {"mix": {"cooperative": 0.5}}},
    {"road": {"num_lanes": 4}, "warmup": [1.0, 2.0]},
    {"action": {"longitudinal": {"max_speed": 30.0}}},
    {"observation": {"features": ["yaw"]}, "horizon": None},
    {},
]


@pytest.mark.parametrize("changes", CHANGES, ids=str)
def test_a_file_a_mapping_and_overrides_mean_the_same(tmp_path, changes):
    path = written(tmp_path, json.dumps(changes))
    paper = load_scenario("paper", changes).model_dump()
    for scenario in (load_scenario(path), load_scenario(changes), load_scenario({}, changes)):
        ignored = {"name": paper["name"], "description": paper["description"]}
        assert scenario.model_dump() | ignored == paper


def test_what_is_not_named_keeps_its_default():
    scenario = load_scenario({"drivers": HASTY, "followers": CHANGES[2]["followers"]})
    aggressive = scenario.drivers.profiles["aggressive"]
    assert (aggressive.time_headway, aggressive.minimum_gap) == (0.5, 3.0)
    assert set(scenario.drivers.profiles) == {"normal", "aggressive", "defensive", "truck"}
    assert scenario.followers.learned.adversarial.delay_weight == 0.2
    assert scenario.followers.learned.adversarial.abort_weight == 1.0


def test_a_new_profile_begins_with_the_default_values_of_normal():
    changes = {"normal": {"minimum_gap": 9.0}, "late": {"time_headway": 2.0}}
    profiles = load_scenario({"drivers": {"profiles": changes}}).drivers.profiles
    default = load_scenario("paper").drivers.profiles["normal"]
    assert profiles["late"] == default.model_copy(update={"time_headway": 2.0})


def test_a_profile_may_be_called_mix():
    profiles = {"mix": {"time_headway": 2.0, "minimum_gap": 4.0}}
    base = load_scenario({"drivers": {"profiles": profiles, "mix": {"mix": 1.0}}})
    changed = load_scenario(base, {"drivers": {"profiles": {"mix": {"minimum_gap": 3.0}}}})
    assert changed.drivers.profiles["mix"].time_headway == 2.0


def test_a_section_in_a_mapping_is_whole():
    road = load_scenario({"road": {"num_lanes": 4, "length": 500.0}}).road
    assert load_scenario({"road": road}, {"road": {"length": 600.0}}).road.num_lanes == 4


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


def test_merge_keys_and_scientific_notation_are_read(tmp_path):
    path = written(
        tmp_path,
        "horizon: 1e6\nreward: {longitudinal_weight: 5e-3}\n"
        "drivers:\n  profiles:\n    car: &car {minimum_gap: 3.0, time_headway: 1.5}\n"
        "    hasty: {<<: *car, time_headway: 6e-1}\n",
    )
    scenario = load_scenario(path)
    assert scenario.horizon == 1e6
    assert scenario.reward.longitudinal_weight == 0.005
    hasty = scenario.drivers.profiles["hasty"]
    assert (hasty.minimum_gap, hasty.time_headway) == (3.0, 0.6)


@pytest.mark.parametrize(
    "overrides",
    [
        {"num_slots": np.int64(3)},
        {"num_slots": np.uint8(3)},
        {"num_slots": np.array(3)},
        {"time_step": np.float32(0.25)},
        {"time_step": np.array(0.25)},
        {"warmup": np.array([1, 2])},
        {"warmup": (np.float32(1.0), np.int8(2))},
        {"command": {"lanes": np.array([1])}},
        {"followers": {"cooperative": {"moves_over": np.True_}}},
        {"observation": {"features": np.array(["speed", "yaw"])}},
        {np.str_("description"): np.str_("text")},
        MappingProxyType({"road": MappingProxyType({"num_lanes": 4})}),
    ],
    ids=repr,
)
def test_numpys_values_are_as_pythons(overrides):
    scenario = load_scenario("paper", overrides)
    assert scenario == load_scenario({"name": "paper"} | scenario.model_dump(), overrides)
    plain = json.loads(scenario.model_dump_json())
    assert load_scenario(plain) == scenario
    assert scenario != load_scenario("paper")


@pytest.mark.parametrize(
    ("overrides", "part"),
    [
        ({"num_slots": np.float64(3.0)}, "num_slots = 3.0: must be a valid integer"),
        ({"num_slots": np.True_}, "num_slots = True: must be a valid integer"),
        ({"time_step": np.float32(np.nan)}, "time_step = nan: must be a finite number"),
        ({"num_slots": np.zeros(10**6)}, "num_slots = array([0., 0., 0., ..., 0., 0., 0.]"),
        ({"time_step": np.complex64(1j)}, "time_step = 1j: must be a valid number"),
        ({"road": np.zeros((2, 2))}, "road = [[0.0, 0.0], [0.0, 0.0]]: must be a mapping"),
    ],
    ids=repr,
)
def test_numpys_values_are_refused_as_pythons(overrides, part):
    assert part in error_of("paper", overrides)


class Text(bytes):
    pass


@pytest.mark.parametrize("source", [None, 5, b"paper", ["paper"], np.array(["paper"]), {1}, Text])
def test_a_source_of_another_type_is_refused(source):
    message = error_of(source)
    assert message.startswith("scenario = ")
    assert "must be a name, the path of a .yaml file, a mapping of fields, or a Scenario" in message


@pytest.mark.parametrize("overrides", [[], "", 0, b"", "road", [("road", {})], np.array([1.0])])
def test_overrides_of_another_type_are_refused(overrides):
    for source in ("paper", load_scenario("paper")):
        message = error_of(source, overrides)
        assert message.startswith("overrides = ")
        assert message.endswith("must be a mapping of fields, or None")


@pytest.mark.parametrize(
    ("overrides", "part"),
    [
        ({1: 2}, "1: a key must be text"),
        ({b"road": {}}, "b'road': a key must be text"),
        ({"road": {None: 1}}, "road.None: a key must be text"),
        ({"road": {"arcs": [{2.5: 1}]}}, "road.arcs.0.2.5: a key must be text"),
        ({"road\n": {None: 1}}, "'road\\n'.None: a key must be text"),
    ],
    ids=str,
)
def test_a_key_of_another_type_is_refused(overrides, part):
    assert error_of("paper", overrides) == f"scenario 'paper': {part}"
    assert error_of(overrides).endswith(part)


def checkpoint_of(path):
    return load_scenario(path).followers.learned.checkpoint


def test_a_file_names_a_checkpoint_in_its_own_folder(tmp_path):
    path = written(tmp_path, "followers: {learned: {checkpoint: runs/final.pt}}\n")
    assert checkpoint_of(path) == str(tmp_path / "runs" / "final.pt")
    text = f"followers: {{learned: {{checkpoint: {tmp_path / 'own.pt'}}}}}\n"
    assert checkpoint_of(written(tmp_path, text)) == str(tmp_path / "own.pt")


def test_a_policy_of_the_zoo_is_no_path(tmp_path):
    path = written(tmp_path, "followers: {learned: {checkpoint: 'zoo:adversary'}}\n")
    assert checkpoint_of(path) == "zoo:adversary"
    # YAML reads it as text without quotes, too.
    path = written(tmp_path, "followers: {learned: {checkpoint: zoo:adversary}}\n")
    assert checkpoint_of(path) == "zoo:adversary"


@needs_links
@pytest.mark.parametrize(
    "name",
    [
        "/etc/passwd",
        "../final.pt",
        "a/../../final.pt",
        "out/final.pt",
        "/dev/zero",
        "./zoo:/../../x",
    ],
)
def test_a_file_names_no_checkpoint_outside_of_its_folder(tmp_path, name):
    folder = tmp_path / "mine"
    folder.mkdir()
    (folder / "out").symlink_to(tmp_path)
    path = written(folder, f"followers: {{learned: {{checkpoint: {name}}}}}\n")
    message = error_of(path)
    assert f"followers.learned.checkpoint = '{name}': must be in the folder of the" in message


@needs_links
def test_a_circle_of_links_ends(tmp_path):
    (tmp_path / "circle").symlink_to("circle")
    path = written(tmp_path, "followers: {learned: {checkpoint: circle/final.pt}}\n")
    # Some versions of Python find the circle here, others when the file is opened.
    with suppress(ScenarioError):
        load_scenario(path)


def test_a_checkpoint_of_a_mapping_or_of_overrides_may_be_anywhere(tmp_path):
    learned = {"followers": {"learned": {"checkpoint": "../final.pt"}}}
    path = written(tmp_path, "num_slots: 3\n")
    for scenario in (load_scenario(learned), load_scenario(path, learned)):
        assert scenario.followers.learned.checkpoint == "../final.pt"


@pytest.mark.parametrize("name", ["", "a\0b", 5])
def test_a_checkpoint_that_is_no_path_is_refused(tmp_path, name):
    path = written(tmp_path, json.dumps({"followers": {"learned": {"checkpoint": name}}}))
    assert f"followers.learned.checkpoint = {name!r}: must" in error_of(path)
