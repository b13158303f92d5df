"""The scenario schema, its errors, and the shipped YAML files."""

import re
from pathlib import Path

import numpy as np
import pytest
import yaml
from pydantic import BaseModel
from staging import damped_actions

from marl_lanes.scenario import Scenario, ScenarioError, list_scenarios, load_scenario
from marl_lanes.scenario import followers as followers_module
from marl_lanes.scenario import schema as schema_module
from marl_lanes.traffic.roles.changer import FEATURES
from marl_lanes.traffic.simulator import Simulator

UNITS = {"m", "m/s or 'x km/h'", "m/s", "m/s^2", "rad/s", "rad/s^2", "s", "1", "count", "section"}
UNITS |= {"text", "map", "list", "name", "1/(rad/s^2)", "1/(rad/s)"}
UNITS |= {"1/s", "s^2/m", "s^4/m^2", "bool", "path"}


def sections():
    """Every model of the schema."""
    named = {**vars(followers_module), **vars(schema_module)}
    found = [value for value in named.values() if isinstance(value, type)]
    return [value for value in found if issubclass(value, BaseModel) and value is not BaseModel]


def fields():
    return [
        pytest.param(field, id=f"{section.__name__}.{name}")
        for section in sections()
        for name, field in section.model_fields.items()
    ]


def error_of(source="paper", overrides=None):
    with pytest.raises(ScenarioError) as caught:
        load_scenario(source, overrides)
    return str(caught.value)


def written(tmp_path, text):
    path = tmp_path / "mine.yaml"
    path.write_text(text, encoding="utf-8")
    return path


# The shipped files


def test_the_shipped_scenarios_are_listed():
    names = list_scenarios()
    assert names == sorted(names)
    expected = {"paper", "dense", "curved", "cooperative", "adversarial", "touch", "five_lanes"}
    assert expected <= set(names)


@pytest.mark.parametrize("name", list_scenarios())
def test_every_shipped_scenario_loads_and_runs(name):
    scenario = load_scenario(name)
    assert scenario.name == name
    assert scenario.description.endswith(".")
    simulator = Simulator(name, 2, seed=1)
    simulator.reset()
    for _ in range(200):
        simulator.step(damped_actions(simulator))
    assert np.isfinite(simulator.vehicles["position"]).all()
    assert simulator.roads["num_commands"].sum() > 0
    assert np.isfinite(simulator.state.observations).all()
    assert simulator.roads["num_collisions"].sum() == 0


def test_the_paper_is_the_schemas_defaults_and_says_every_field_that_counts():
    paper = load_scenario("paper")
    defaults = Scenario(name="paper", description=paper.description)
    assert paper == defaults
    file = Path(__file__).parents[2] / "scenarios" / "paper.yaml"
    spelled = yaml.safe_load(file.read_text(encoding="utf-8"))
    dumped = defaults.model_dump(mode="json")
    assert set(dumped) - set(spelled) == {"name"}
    for name, value in spelled.items():
        if isinstance(value, dict):
            unsaid = {field: dumped[name][field] for field in set(dumped[name]) - set(value)}
            # A road without arcs need not say so, nor a reward that a term has the weight 0.
            assert all(not default for default in unsaid.values()), unsaid


def test_the_defaults_are_the_papers_numbers():
    paper = load_scenario()
    assert paper.name == "paper"
    assert (paper.road.length, paper.road.num_lanes, paper.road.lane_width) == (1000.0, 3, 3.75)
    assert paper.time_step == 0.1
    normal = paper.drivers.profiles["normal"]
    assert (normal.minimum_gap, normal.time_headway, normal.exponent) == (5.0, 1.0, 4.0)
    assert (normal.max_acceleration, normal.comfortable_braking) == (2.0, 1.5)
    assert paper.departures.interval == (5.0, 10.0)
    assert paper.departures.initial_speed == pytest.approx((30.0 / 3.6, 50.0 / 3.6))
    assert paper.departures.desired_speed == pytest.approx((80.0 / 3.6, 120.0 / 3.6))
    assert paper.command.probability == pytest.approx(1.0 / 3.0)
    reward = paper.reward
    weights = (reward.yaw_acceleration_weight, reward.yaw_rate_weight, reward.deviation_weight)
    assert weights == (2.0, 0.5, 0.05)
    assert reward.average_deviation == paper.road.lane_width / 2.0


def test_a_scenario_survives_its_own_dump():
    for name in list_scenarios():
        scenario = load_scenario(name)
        assert load_scenario(scenario.model_dump(mode="json")) == scenario
        assert load_scenario(scenario, {}) is scenario


# The fields


@pytest.mark.parametrize("field", fields())
def test_every_field_says_what_it_is_and_its_unit(field):
    unit = re.search(r"\[([^\]]+)\]", field.description or "")
    assert unit, field.description
    assert unit[1] in UNITS or unit[1].startswith("list of"), unit[1]


def test_the_schema_names_every_feature_of_the_traffic():
    every = [feature.name for feature in FEATURES]
    scenario = load_scenario("paper", {"observation": {"features": every}})
    assert list(scenario.observation.features) == every


@pytest.mark.parametrize(
    ("text", "speed"),
    [("36 km/h", 10.0), ("10 m/s", 10.0), ("90.0km/h", 25.0), (" 18 km/h ", 5.0), (12.5, 12.5)],
)
def test_speeds_may_be_written_with_their_unit(text, speed):
    scenario = load_scenario("paper", {"departures": {"initial_speed": [text, "60 m/s"]}})
    assert scenario.departures.initial_speed == pytest.approx((speed, 60.0))


def test_a_scenario_cannot_be_changed():
    scenario = load_scenario("paper")
    with pytest.raises(ValueError, match="frozen"):
        scenario.road.length = 5.0


# Overrides


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


def test_a_new_profile_beside_the_others():
    late = {"minimum_gap": 4.0, "time_headway": 2.0}
    drivers = {"profiles": {"late": late}, "mix": {"late": 1.0, "normal": 1.0}}
    scenario = load_scenario("paper", {"drivers": drivers})
    assert set(scenario.drivers.profiles) == {"normal", "aggressive", "defensive", "late"}


# Errors: the field, its value, the allowed values

WRONG = [
    ({"colour": 1}, ["colour: unknown key; allowed: name, description, time_step"]),
    (
        {"road": {"lanes": 3}},
        ["road.lanes: unknown key; did you mean num_lanes? allowed: length, num_lanes, lane_width"],
    ),
    ({"road": {"num_lanes": "3"}}, ["road.num_lanes = '3': must be a valid integer"]),
    ({"road": {"num_lanes": 2.5}}, ["road.num_lanes = 2.5: must be a valid integer"]),
    ({"road": {"num_lanes": True}}, ["road.num_lanes = True: must be a valid integer"]),
    ({"road": {"num_lanes": 1}}, ["road.num_lanes = 1: must be greater than or equal to 2"]),
    ({"road": {"length": "long"}}, ["road.length = 'long': must be a valid number"]),
    ({"road": {"length": float("nan")}}, ["road.length = nan: must be a finite number"]),
    ({"road": {"length": float("inf")}}, ["road.length = inf: must be a finite number"]),
    ({"road": 5}, ["road = 5: must be a valid dictionary"]),
    ({"time_step": 0.0}, ["time_step = 0.0: must be greater than"]),
    ({"time_step": -0.1}, ["time_step = -0.1: must be greater than"]),
    ({"horizon": 0.0}, ["horizon = 0.0: must be greater than 0"]),
    ({"warmup": [90.0, 60.0]}, ["warmup = ", "must not be above the second"]),
    ({"warmup": [1.0]}, ["warmup", "1"]),
    ({"command": {"position": [140.0, 1200.0]}}, ["command.position = [140.0, 1200.0]", "1000.0"]),
    ({"command": {"lanes": [0]}}, ["command.lanes = [0] must be among the middle lanes [1]"]),
    ({"command": {"lanes": [2]}}, ["command.lanes = [2] must be among the middle lanes [1]"]),
    ({"command": {"lanes": [-1]}}, ["command.lanes = [-1] must be among the middle lanes [1]"]),
    ({"command": {"lanes": [1, 1]}}, ["command.lanes", "1, 1"]),
    ({"command": {"probability": 1.5}}, ["command.probability = 1.5: must be less than or equal"]),
    ({"road": {"num_lanes": 2}}, ["command.probability", "must be 0", "road.num_lanes = 2"]),
    ({"followers": {"mix": {"neutral": 0.0}}}, ["followers.mix", "sum to more than 0"]),
    ({"drivers": {"mix": {"normal": 0.0}}}, ["drivers.mix", "sum to more than 0"]),
    ({"drivers": {"mix": {"normal": -1.0}}}, ["drivers.mix.normal = -1.0", "or equal to 0"]),
    ({"drivers": {"mix": {"sporty": 1.0}}}, ["drivers.mix", "sporty", "aggressive", "normal"]),
    ({"followers": {"mix": {"very rude": 1.0}}}, ["followers.mix.very rude"]),
    ({"followers": {"mix": {"rude": -1.0}}}, ["followers.mix.rude = -1.0", "or equal to 0"]),
    ({"action": {"longitudinal": {"max_speed": 0.0}}}, ["longitudinal.max_speed = 0.0", "than 0"]),
    ({"departures": {"initial_speed": ["fast", 9.0]}}, ["initial_speed", "'fast'", "'30 km/h'"]),
    ({"departures": {"initial_speed": ["30 mph", 9.0]}}, ["'30 mph'", "'30 km/h'"]),
    (
        {"departures": {"initial_speed": ["0 km/h", 9.0]}},
        ["initial_speed.0 = 0.0", "greater than 0"],
    ),
    ({"observation": {"features": []}}, ["observation.features", "at least 1"]),
    ({"observation": {"features": ["sped"]}}, ["observation.features.0 = 'sped'", "'speed'"]),
    ({"observation": {"features": ["yaw", "yaw"]}}, ["observation.features", "['yaw']", "once"]),
    ({"vehicle": {"width": 2.5}, "road": {"lane_width": 2.5}}, ["vehicle.width = 2.5", "2.5"]),
    ({"completion": {"max_deviation": 1.9}}, ["completion.max_deviation = 1.9", "3.75"]),
    ({"drivers": {"car_following": "min"}}, ["car_following = 'min'", "'max', 'sum' or 'acc'"]),
]
ARCS = [
    ([{"start": 10.0, "end": 5.0, "radius": 500.0}], ["start 10.0", "end 5.0"]),
    ([{"start": 10.0, "end": 5000.0, "radius": 500.0}], ["end 5000.0", "length = 1000.0"]),
    ([{"start": 10.0, "end": 50.0, "radius": 10.0}], ["|radius| = 10.0", "50 m"]),
    ([{"start": 10.0, "end": 50.0, "radius": 0.0}], ["|radius| = 0.0", "50 m"]),
    ([{"start": 10.0, "end": 50.0}], ["road.arcs.0.radius: must be given"]),
    (
        [{"start": 10.0, "end": 50.0, "radius": 90.0, "bend": 1}],
        ["road.arcs.0.bend: unknown key; did you mean end? allowed: start, end, radius"],
    ),
    (
        [{"start": 10.0, "end": 50.0, "radius": 90.0, "transition": 21.0}],
        ["transition = 21.0 of the arc from 10.0 to 50.0 must be at most half", "20.0"],
    ),
    (
        [{"start": 10.0, "end": 50.0, "radius": 90.0, "transition": -1.0}],
        ["transition = -1.0", "greater than or equal to 0"],
    ),
    (
        [
            {"start": 10.0, "end": 50.0, "radius": 500.0, "transition": 5.0},
            {"start": 40.0, "end": 60.0, "radius": 500.0, "transition": 5.0},
        ],
        ["starts at 40.0", "ends at 50.0"],
    ),
]
WRONG += [({"road": {"arcs": arcs}}, parts) for arcs, parts in ARCS]


@pytest.mark.parametrize(("overrides", "parts"), WRONG, ids=[str(row[0]) for row in WRONG])
def test_what_cannot_be_is_refused_with_field_value_and_what_is_allowed(overrides, parts):
    message = error_of("paper", overrides)
    assert message.startswith("scenario 'paper': ")
    assert "\n" not in message
    for part in parts:
        assert part in message


@pytest.mark.parametrize("name", ["rude", "learned"])
def test_a_disposition_without_a_policy_is_refused_when_the_traffic_is_built(name):
    scenario = load_scenario("paper", {"followers": {"mix": {"neutral": 1.0, name: 1.0}}})
    assert scenario.followers.external_names == (name,)
    with pytest.raises(ScenarioError) as caught:
        Simulator(scenario)
    for part in ("scenario 'paper'", f"followers.mix: '{name}' has no policy", "cooperative"):
        assert part in str(caught.value)
    Simulator(scenario, follower_policies={name: lambda seen: 0.0 * seen[:, 0]})


def test_one_error_names_every_problem():
    message = error_of({"road": {"length": 5.0}, "time_step": 9.0, "colour": 1})
    assert message.startswith("scenario from a mapping: ")
    for part in ("road.length = 5.0", "time_step = 9.0", "colour: unknown key"):
        assert part in message


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


@pytest.mark.parametrize("horizon", [0.01, 1e300])
def test_a_horizon_that_cannot_be_counted_in_steps_is_refused(horizon):
    """Rounded to 0 steps a horizon would mean no end; beyond 64 bits it cannot be stored."""
    assert "horizon" in error_of("paper", {"horizon": horizon})


def test_the_gaps_stay_within_the_bounds_of_their_feature():
    gap = next(feature for feature in FEATURES if feature.name == "leader_gap")
    load_scenario("paper", {"observation": {"sensor_range": gap.high}})
    message = error_of("paper", {"observation": {"sensor_range": 1.01 * gap.high}})
    assert "observation.sensor_range" in message


def test_shares_whose_sum_overflows_are_refused():
    assert "mix" in error_of("paper", {"drivers": {"mix": {"normal": 1e308, "aggressive": 1e308}}})
