"""The scenario's numbers in the form that kernels read."""

import dataclasses
import math

import numpy as np
import pytest

from marl_lanes.scenario import load_scenario
from marl_lanes.traffic.parameters import ARC, CONSTANTS, PROFILE, make_parameters


def made(**overrides):
    return make_parameters(load_scenario("paper", overrides))


@pytest.mark.parametrize("table", [CONSTANTS, PROFILE, ARC])
def test_every_number_has_a_name_of_its_own(table):
    assert len({row[0] for row in table}) == len(table)
    assert all(name.islower() for name, *_ in table)


def test_kernels_take_the_arrays_in_the_order_of_the_fields():
    found = made()
    names = [field.name for field in dataclasses.fields(found)]
    assert [id(getattr(found, name)) for name in names] == [id(array) for array in found.arrays]


@pytest.mark.parametrize(
    ("overrides", "expected"),
    [
        ({"horizon": 12.0, "time_step": 0.25}, {"horizon_steps": 48, "time_step": 0.25}),
        ({"horizon": None}, {"horizon_steps": 0}),
        ({"num_agents": None}, {"num_agents": 0}),
        ({"drivers": {"car_following": "max"}}, {"is_sum_form": 0, "is_acc": 0}),
        ({"drivers": {"car_following": "sum"}}, {"is_sum_form": 1, "is_acc": 0}),
        ({"drivers": {"car_following": "acc"}}, {"is_sum_form": 1, "is_acc": 1}),
        ({"gap": {"rule": "kinematic"}}, {"is_gap_kinematic": 1}),
        ({"road": {"num_lanes": 5}}, {"num_lanes": 5, "command_lanes": 0b01110}),
        (
            {"road": {"num_lanes": 5}, "command": {"lanes": [3, 1]}},
            {"command_lanes": 0b01010},
        ),
        (
            {"completion": {"max_lateral_speed": None, "max_yaw_rate": None}},
            {"completion_max_lateral_speed": math.inf, "completion_max_yaw_rate": math.inf},
        ),
        ({}, {"has_longitudinal": 0, "completion_max_yaw_rate": 0.03}),
        (
            {"action": {"longitudinal": {"max_braking": 2.5}}},
            {"has_longitudinal": 1, "longitudinal_max_braking": 2.5},
        ),
        ({"followers": {"mix": {"neutral": 1.0, "rude": 1.0, "kind": 2.0}}}, {"num_external": 2}),
    ],
)
def test_what_a_field_is_to_the_kernels(overrides, expected):
    constants = made(**overrides).constants[0]
    assert {name: constants[name] for name in expected} == expected


def test_shares_add_up_to_one():
    mix = {"adversarial": 3.0, "rude": 1.0, "cooperative": 4.0}
    drivers = {"mix": {"defensive": 3.0, "normal": 1.0}}
    found = made(followers={"mix": mix}, drivers=drivers)
    # By disposition; the external ones come last, whatever their place in the mix.
    assert found.dispositions.tolist() == [0.5, 0.5, 0.875, 1.0]
    assert found.profiles["share"].tolist() == [0.25, 0.25, 1.0, 1.0]


def test_a_profile_brings_its_numbers_and_their_products():
    found = made(followers={"adversarial": {"max_acceleration": 6.0}}).profiles[1]
    numbers = {"minimum_gap": 3.0, "time_headway": 0.6, "max_acceleration": 3.0, "exponent": 4.0}
    assert {name: found[name] for name in numbers} == numbers
    assert found["braking_scale"] == pytest.approx(2.0 * math.sqrt(3.0 * 2.5))
    assert found["adversarial_braking_scale"] == pytest.approx(2.0 * math.sqrt(6.0 * 2.5))


def test_an_arc_to_the_right_has_a_negative_curvature():
    arcs = [
        {"start": 100.0, "end": 300.0, "radius": 200.0, "transition": 40.0},
        {"start": 300.0, "end": 400.0, "radius": -500.0},
    ]
    found = made(road={"arcs": arcs}).arcs
    assert found["curvature"].tolist() == [1.0 / 200.0, -1.0 / 500.0]
    assert found["start"].tolist() == [100.0, 300.0]
    assert found["end"].tolist() == [300.0, 400.0]
    assert found["transition"][0] == 40.0
    assert len(made().arcs) == 0


def test_features_are_numbered_in_the_scenarios_order():
    one = made(observation={"features": ["yaw", "speed"]}).features
    other = made(observation={"features": ["speed", "yaw"]}).features
    assert one.dtype == np.int32
    assert one.tolist() == other[::-1].tolist()


def test_the_size_and_the_speed_of_a_profile_are_its_own_or_the_scenarios():
    drivers = {"mix": {"normal": 1.0, "truck": 1.0}, "profiles": {"truck": {"width": None}}}
    found = made(drivers=drivers, vehicle={"length": 5.0, "width": 2.0})
    normal, truck = found.profiles[0], found.profiles[3]
    assert (normal["half_length"], normal["half_width"]) == (2.5, 1.0)
    assert (truck["half_length"], truck["half_width"]) == (8.25, 1.0)
    assert normal["desired_speed_high"] == pytest.approx(120.0 / 3.6)
    assert truck["desired_speed_high"] == pytest.approx(90.0 / 3.6)
    constants = found.constants[0]
    assert constants["longest_diagonal"] == pytest.approx(math.hypot(16.5, 2.0))
    assert (constants["shortest_length"], constants["narrowest_width"]) == (5.0, 2.0)
    # Bodies that no vehicle has do not count.
    assert made().constants[0]["longest_diagonal"] == pytest.approx(math.hypot(4.8, 1.8))
