"""A role is one definition: everything follows from its rows."""

import copy
import pickle
from dataclasses import replace

import numpy as np
import pytest

from marl_lanes.scenario import load_scenario
from marl_lanes.traffic.machine.compiled import compiled
from marl_lanes.traffic.roles.changer import CHANGER
from marl_lanes.traffic.roles.follower import FOLLOWER
from marl_lanes.traffic.roles.role import Feature, Term, make_observer, make_payment, role_named

ROLES = (CHANGER, FOLLOWER)


@pytest.mark.parametrize("role", ROLES, ids=lambda role: role.name)
def test_every_term_has_its_weight_in_the_scenario(role):
    scenario = load_scenario("interactive")
    section = role.reward(scenario).model_dump()
    assert {term.weight for term in role.terms} <= set(section)
    wanted = [section[term.weight] for term in role.terms]
    assert role.weights(scenario) == wanted
    assert len({term.name for term in role.terms}) == len(role.terms)


@pytest.mark.parametrize("role", ROLES, ids=lambda role: role.name)
def test_a_copy_is_the_role_itself(role):
    assert pickle.loads(pickle.dumps(role)) is role  # noqa: S301
    assert copy.deepcopy([role])[0] is role
    assert role_named(role.name) is role


def test_bounds_and_codes_are_those_of_the_scenario():
    scenario = load_scenario("paper", {"observation": {"features": ["yaw", "speed"]}})
    low, high = CHANGER.observation_bounds(scenario)
    assert low.tolist() == [np.float32(-np.pi), 0.0]
    assert high.tolist() == [np.float32(np.pi), 150.0]
    assert [feature.name for feature in CHANGER.seen(scenario)] == ["yaw", "speed"]
    assert CHANGER.codes(scenario).tolist() == [4, 0]
    low, high = CHANGER.action_bounds(load_scenario("interactive"))
    assert (low.tolist(), high.tolist()) == ([-0.5, -3.0], [0.5, 2.0])
    low, high = FOLLOWER.action_bounds(scenario)
    assert (low.tolist(), high.tolist()) == ([-3.0], [3.0])


def test_stacked_observations_have_the_columns_of_one_each():
    fields = {"features": ["yaw", "speed"], "num_stacked": 3}
    scenario = load_scenario("paper", {"observation": fields})
    names = ["yaw", "speed", "yaw@1", "speed@1", "yaw@2", "speed@2"]
    assert [feature.name for feature in CHANGER.seen(scenario)] == names
    assert CHANGER.codes(scenario).tolist() == [4, 0]
    low, high = CHANGER.observation_bounds(scenario)
    assert low.reshape(3, 2).tolist() == [low[:2].tolist()] * 3
    assert high.tolist() == [np.float32(np.pi), 150.0] * 3


def feature(name, formula, high=100.0):
    return Feature(name, "1", 0.0, 1.0, -1.0, high, "", formula)


def test_features_are_written_in_the_order_of_their_codes():
    rows = [feature("sum", lambda a, b: a + b), feature("product", lambda a, b: a * b)]
    rows.append(feature("first", lambda a, _: a))
    observe = make_observer(rows)

    @compiled
    def look(codes, seen, a, b):
        observe(codes, seen, a, b)

    seen = np.zeros(4, np.float32)
    look(np.array([2, 1, 0, 1], np.int32), seen, 3.0, 5.0)
    assert seen.tolist() == [3.0, 15.0, 8.0, 15.0]


@pytest.mark.parametrize(("value", "seen"), [(-9.0, -1.0), (-1.0, -1.0), (2.0, 2.0), (9.0, 3.0)])
def test_a_feature_beyond_its_bounds_is_observed_as_the_bound(value, seen):
    observe = make_observer([feature("x", lambda x: x, high=3.0)])

    @compiled
    def look(codes, seen, x):
        observe(codes, seen, x)

    found = np.zeros(1, np.float32)
    look(np.zeros(1, np.int32), found, value)
    assert found.tolist() == [seen]


def test_terms_are_weighted_summed_and_added_up_over_time():
    terms = (
        Term("a", "w", "1", "", lambda w, x: w * x),
        Term("b", "w", "1", "", lambda w, x: -w * x * x),
        Term("c", "w", "1", "", lambda w, _: w),
    )
    role = replace(CHANGER, terms=terms)
    record = np.zeros(1, role.dtype)
    pay = make_payment(terms)

    @compiled
    def settle(records, weights, x):
        pay(records[0], weights, x)

    for _ in range(2):
        settle(record, np.array([2.0, 3.0, 7.0]), 4.0)
    assert record["terms"].tolist() == [[8.0, -48.0, 7.0]]
    assert (record["reward"][0], record["episode_reward"][0]) == (-33.0, -66.0)
    assert {name: value.tolist() for name, value in role.terms_of(record).items()} == {
        "reward_a": [8.0],
        "reward_b": [-48.0],
        "reward_c": [7.0],
    }
