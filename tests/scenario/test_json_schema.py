"""The JSON Schema of scenarios: the file that ships, and what it accepts."""

import json

import pytest
import yaml
from jsonschema import Draft202012Validator
from packaging.version import Version
from pydantic import VERSION

from marl_lanes import ScenarioError, list_scenarios, load_scenario
from marl_lanes.scenario.json_schema import FILE, make_json_schema

SCHEMA = json.loads(FILE.read_text(encoding="utf-8"))
VALIDATOR = Draft202012Validator(SCHEMA)


@pytest.mark.skipif(Version(VERSION) < Version("2.10"), reason="says less of a map's keys")
def test_the_file_is_what_pydantic_gives():
    hint = f"marl-lanes schema > marl_lanes/scenario/{FILE.name}"
    assert make_json_schema() == SCHEMA, hint


@pytest.mark.parametrize("name", list_scenarios())
def test_it_accepts_every_shipped_scenario_as_it_is_written_and_in_full(name, request):
    file = request.config.rootpath / "scenarios" / f"{name}.yaml"
    VALIDATOR.validate(yaml.safe_load(file.read_text(encoding="utf-8")))
    VALIDATOR.validate(load_scenario(name).model_dump(mode="json"))


@pytest.mark.parametrize(
    ("text", "is_accepted"),
    [
        ("{}", True),
        ("departures: {desired_speed: [70 km/h, 30.5]}", True),
        ("departures: {desired_speed: [70 mph, 30.5]}", False),
        ("departures: {desired_speed: [70 km/h, 71.0]}", False),
        ("departures: {desired_speed: [70 km/h]}", False),
        ("departures: {interval: [0.01, 5.0]}", False),
        ("num_agent: 3", False),
        ("num_agents: three", False),
        ("num_agents: null", True),
        ("road: {arcs: [{start: 100.0, end: 300.0, radius: 500.0}]}", True),
        ("road: {arcs: [{start: 100.0, end: 300.0}]}", False),
        ("followers: {learned: {adversarial: {delay_weight: 0.2}}}", True),
        ("observation: {features: [speed, colour]}", False),
    ],
)
def test_what_it_accepts_is_what_is_loaded(text, is_accepted):
    fields = yaml.safe_load(text)
    assert VALIDATOR.is_valid(fields) == is_accepted
    if is_accepted:
        load_scenario(fields)
    else:
        with pytest.raises(ScenarioError):
            load_scenario(fields)
