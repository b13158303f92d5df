"""Messages about wrong fields: the nearest key, and every problem at once."""

import pytest
from scenario.refusals import assert_refused, error_of

from marl_lanes.scenario.messages import MAX_PROBLEMS, MAX_SHOWN, shown, shown_name

WRONG = [
    ({"colour": 1}, ["colour: unknown key; allowed: name, description, time_step"]),
    (
        {"road": {"lanes": 3}},
        ["road.lanes: unknown key; did you mean num_lanes? allowed: length, num_lanes, lane_width"],
    ),
    (
        {"road": {"arcs": [{"start": 10.0, "end": 50.0}]}},
        ["road.arcs.0.radius: must be given"],
    ),
    (
        {"road": {"arcs": [{"start": 10.0, "end": 50.0, "radius": 90.0, "bend": 1}]}},
        ["road.arcs.0.bend: unknown key; did you mean end? allowed: start, end, radius"],
    ),
]


@pytest.mark.parametrize(("overrides", "parts"), WRONG, ids=[str(row[0]) for row in WRONG])
def test_what_cannot_be_is_refused_with_field_value_and_what_is_allowed(overrides, parts):
    assert_refused(overrides, parts)


def test_one_error_names_every_problem():
    message = error_of({"road": {"length": 5.0}, "time_step": 9.0, "colour": 1})
    assert message.startswith("scenario from a mapping: ")
    for part in ("road.length = 5.0", "time_step = 9.0", "colour: unknown key"):
        assert part in message


def test_of_many_problems_the_first_are_named_and_the_others_counted():
    message = error_of({"observation": {"features": ["wrong"] * 50_000}})
    assert message.count("observation.features.") == MAX_PROBLEMS
    assert message.endswith("; and 49,991 more")


def test_each_value_is_short_and_on_one_line():
    long = "two\nlines " * 10_000
    message = error_of({"road": {"length": long}, "gap": {"rule": long}, long: 1, "time_step": {}})
    assert "\n" not in message
    assert len(message) < 1500
    for part in ("road.length = 'two", "gap.rule = 'two", "'two\\nlines", "time_step = {}"):
        assert part in message


@pytest.mark.parametrize(
    ("name", "text"),
    [("a/b c.yaml", "a/b c.yaml"), ("a\nb", r"'a\nb'"), ("\x1b[2J", r"'\x1b[2J'"), (3, "3")],
)
def test_a_name_is_shown_as_it_is_if_it_can_be(name, text):
    assert shown_name(name) == text
    assert len(shown_name("x" * 10**6)) <= MAX_SHOWN


class Unshowable:
    def __repr__(self):
        raise RuntimeError


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.3, "0.3"),
        ("two\nlines", r"'two\nlines'"),
        ([1, 2], "[1, 2]"),
        (Unshowable(), "<Unshowable instance at"),
        (10**5000, "<int"),
    ],
    ids=["number", "lines", "list", "unshowable", "digits"],
)
def test_a_value_is_shown_on_one_line(value, text):
    assert shown(value).startswith(text)


@pytest.mark.parametrize(
    "value",
    ["x" * 10**6, ["x" * 1000] * 10**5, {str(k): "x" * 90 for k in range(99)}, 10**4000],
    ids=["text", "list", "mapping", "digits"],
)
def test_a_large_value_is_shown_short(value):
    assert len(shown(value)) <= MAX_SHOWN
