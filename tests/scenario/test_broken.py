"""Broken scenarios: each is refused in one line, in the time that a whole one takes."""

import random
import sys
import time
from importlib import resources
from pathlib import Path

import pytest
from scenario.breakages import as_yaml, breakages, faults_of, fields_with
from scenario.refusals import error_of

from marl_lanes.scenario import Scenario, ScenarioError, list_scenarios, load_scenario


def outcome(source):
    """The message of a scenario that is refused, else the scenario; nothing else is raised."""
    try:
        return load_scenario(source)
    except ScenarioError as error:
        return str(error)


def check_breakages(folder, cases):
    file = folder / "broken.yaml"
    for path, value in cases:
        file.write_text(as_yaml(fields_with(path, value)), encoding="utf-8")
        message = outcome(file)
        assert isinstance(message, str), (path, value)
        assert message.startswith(f"scenario file {file}: ")
        assert not faults_of(message, path, value), message


def test_a_broken_field_is_refused_in_one_line(tmp_path):
    check_breakages(tmp_path, breakages()[::5])


@pytest.mark.long
def test_every_field_broken_in_every_way_is_refused_in_one_line(tmp_path):
    check_breakages(tmp_path, breakages())


def test_each_field_is_broken_in_several_ways():
    paths = [path for path, _ in breakages()]
    assert len(paths) > 2000
    assert {"road", "name", "horizon"} <= {path[0] for path in paths}
    assert min(map(paths.count, set(paths))) >= 10


def mutated(content, source):
    """The bytes of a file after a few accidents: flipped bits, cuts, swapped or doubled lines."""
    for _ in range(source.randint(1, 3)):
        place = source.randrange(len(content))
        kind = source.randrange(4)
        if kind == 0:
            flipped = content[place] ^ (1 << source.randrange(8))
            content = content[:place] + bytes([flipped]) + content[place + 1 :]
        elif kind == 1:
            content = content[:place] + content[place + source.randint(1, 30) :]
        elif kind == 2:
            lines = content.splitlines(keepends=True)
            source.shuffle(lines)
            content = b"".join(lines)
        else:
            lines = content.splitlines(keepends=True)
            lines.insert(source.randrange(len(lines)), source.choice(lines))
            content = b"".join(lines)
        content = content or b" "
    return content


def check_mutations(tmp_path, count):
    file = tmp_path / "mutated.yaml"
    source = random.Random(0)  # noqa: S311 - accidents
    num_refused = 0
    for name in list_scenarios():
        whole = resources.files("marl_lanes.scenarios").joinpath(f"{name}.yaml").read_bytes()
        for _ in range(count):
            file.write_bytes(mutated(whole, source))
            found = outcome(file)
            if isinstance(found, Scenario):
                continue
            num_refused += 1
            assert "\n" not in found
            assert len(found) < 5000
    # Some mutations leave a scenario, in a comment or another number.
    assert num_refused > count


def test_mutated_files_are_scenarios_or_refused_in_one_line(tmp_path):
    check_mutations(tmp_path, 20)


@pytest.mark.long
def test_many_mutated_files_are_scenarios_or_refused_in_one_line(tmp_path):
    check_mutations(tmp_path, 2000)


OPENED = []
"""What was opened while it was a list to be filled; a hook for audits stays for good."""


def watch_opened(event, arguments):
    if event == "open" and OPENED:
        OPENED.append(arguments[0])


def test_loading_a_file_opens_that_file_alone(tmp_path):
    """Whichever text of the scenario names another file."""
    sys.addaudithook(watch_opened)
    bait = tmp_path / "bait.yaml"
    bait.write_text("num_slots: 3\n", encoding="utf-8")
    file = tmp_path / "mine.yaml"
    texts = [path for path, value in breakages() if value == "many"] + [("name",), ("description",)]
    load_scenario(tmp_path / "bait.yaml")
    for path in [*texts, ("followers", "learned", "checkpoint")]:
        file.write_text(as_yaml(fields_with(path, str(bait))), encoding="utf-8")
        OPENED[:] = ["begin"]
        outcome(file)
        assert ["begin", str(file)] == OPENED, path
        OPENED.clear()


def endless():
    fields = {}
    fields["road"] = fields
    return fields


def bomb():
    values = ["x"]
    for _ in range(60):
        values = [values, values]
    return {"road": values}


@pytest.mark.parametrize("make", [endless, bomb, lambda: {"road": list(range(200_000))}])
def test_mappings_without_end_are_refused(make):
    expected = "must have at most 100,000 values, nested at most 32 levels deep"
    assert expected in error_of(make())
    assert expected in error_of("paper", make())


@pytest.mark.parametrize(
    "source",
    [
        "a/b\0",
        "x" * 10**6,
        "x/" * 10**5,
        "no\nlines.yaml",
        "\udcff.yaml",
        Path(),
        Path("/dev/zero"),
    ],
    ids=range(7),
)
def test_names_that_cannot_be_are_refused_in_one_short_line(source):
    message = error_of(source)
    assert "\n" not in message
    assert len(message) < 300
    assert message.isprintable()


@pytest.mark.parametrize(
    "fields",
    [
        {"max_vehicles": 10**9},
        {"num_agents": 10**9},
        {"num_slots": 10**9},
        {"road": {"num_lanes": 10**9}},
        {"road": {"arcs": [{"start": 0.0, "end": 1.0, "radius": 100.0}] * 2000}},
        {"command": {"lanes": [1] * 50_000}},
        {"drivers": {"profiles": {f"p{number}": {} for number in range(20_000)}}},
        {"drivers": {"mix": {f"p{number}": 1.0 for number in range(20_000)}}},
        {"followers": {"mix": {f"p{number}": 1.0 for number in range(20_000)}}},
        {"observation": {"features": ["speed"] * 50_000}},
        {"observation": {"features": ["wrong"] * 50_000}},
        {f"key{number}": 1 for number in range(20_000)},
        {"description": "x" * 10**8},
        {"name": "x" * 256},
        {"drivers": {"profiles": {"x" * 256: {}}}},
    ],
    ids=range(15),
)
def test_absurd_sizes_are_refused_in_one_short_line(fields):
    begin = time.process_time()
    message = error_of(fields)
    assert time.process_time() - begin < 5.0
    assert "\n" not in message
    assert len(message) < 5000


@pytest.mark.parametrize("name", ["two\nlines", "bell\a", "escape\x1b[2J", "half\ud800"])
def test_names_with_control_characters_are_refused(name):
    for fields in ({"name": name}, {"drivers": {"profiles": {name: {}}}}):
        message = error_of(fields)
        # Half a character is no text for an older pydantic.
        assert "must have no control characters" in message or "as a unicode string" in message
