"""Results as text."""

import pytest

from marl_lanes.evaluation.crossplay import EXTREMES, MEANS, RATES
from marl_lanes.evaluation.tables import (
    CROSSPLAY_ROWS,
    WIDTH,
    choose_decimals,
    format_crossplay,
    format_estimate,
    format_gaps,
    format_summary,
    format_table,
)


@pytest.mark.parametrize(
    ("estimate", "options", "text"),
    [
        ((0.5, 0.25, 0.75), (), "0.50 [0.25, 0.75]"),
        ((0.9964, 0.99, 1.0), (100.0, 1), "99.6 [99.0, 100.0]"),
        ((7.125, None, None), (1.0, 2), "7.12"),
        ((None, None, None), (100.0, 1), "-"),
        ((0.0, 0.0, 0.0362), (100.0, 1), "0.0 [0.0, 3.6]"),
    ],
)
def test_an_estimate(estimate, options, text):
    assert format_estimate(
        dict(zip(("value", "low", "high"), estimate, strict=True)), *options
    ) == (text)


def test_a_summary_is_a_line_for_every_key():
    text = format_summary({"policy": "x", "success_rate": 0.984375, "cost_ratio": 1.0, "n": 3})
    assert [line.split() for line in text.splitlines()] == [
        ["policy", "x"],
        ["success_rate", "0.98438"],
        ["cost_ratio", "1"],
        ["n", "3"],
    ]


@pytest.mark.parametrize("shown", ["cost_ratio", "completion_rate"])
@pytest.mark.parametrize("success", [{}, {"success_rate": None}])
def test_no_cost_and_no_completion_is_shown_without_success(shown, success):
    with pytest.raises(ValueError, match=f"success_rate = None: must be .* with {shown}"):
        format_summary({shown: 1.0} | success)
    assert format_summary({shown: None} | success)
    assert format_summary({shown: 1.0, "success_rate": 0.0})


def test_a_crossplay_shows_success_first():
    assert [row[0] for row in CROSSPLAY_ROWS[:2]] == ["success_rate", "completion_rate"]


def result(changers, followers):
    """Every rate is the number of its pair in percent."""
    pairs = [
        {
            "changer": changer,
            "followers": follower,
            "statistics": {
                key: {"value": number / 100.0, "low": 0.0, "high": 0.5}
                for key in (*RATES, *MEANS, *EXTREMES)
            },
        }
        for number, (changer, follower) in enumerate((a, b) for a in changers for b in followers)
    ]
    return {
        "num_maneuvers": 50,
        "seed": 3,
        "confidence": 0.95,
        "changers": dict.fromkeys(changers, "paper"),
        "followers": {follower: {} for follower in followers},
        "pairs": pairs,
    }


def test_every_statistic_of_a_crossplay_is_a_row():
    assert [row[0] for row in CROSSPLAY_ROWS if row[0] in (*RATES, *MEANS, *EXTREMES)]
    assert {row[0] for row in CROSSPLAY_ROWS} == {*RATES, *MEANS, *EXTREMES}


def test_a_crossplay():
    text = format_crossplay(result(["one", "two"], ["kind", "rude"]))
    intro, empty, head, *rows = text.splitlines()
    assert intro == "scenario paper; 50 maneuvers per pair, seed 3; value [95 % interval]"
    assert empty == ""
    assert head.split() == ["changer", "kind", "rude"]
    assert len(rows) == 2 * len(CROSSPLAY_ROWS)
    for row, (_, title, factor, _) in zip(rows[::2], CROSSPLAY_ROWS, strict=True):
        assert row.startswith(f"{title} ")
        assert row.removeprefix(title).split()[0] == "one"
        if factor == 100.0:
            assert row.split()[-6:] == ["0.0", "[0.0,", "50.0]", "1.0", "[0.0,", "50.0]"]
    for row, (_, _, factor, _) in zip(rows[1::2], CROSSPLAY_ROWS, strict=True):
        assert row.split()[0] == "two"
        if factor == 100.0:
            assert row.split()[1:] == ["2.0", "[0.0,", "50.0]", "3.0", "[0.0,", "50.0]"]
    # Columns are aligned with their titles.
    assert all(row[head.index("rude") - 1] == " " != row[head.index("rude")] for row in rows)


@pytest.mark.parametrize("number", [1, 4, 5, 9])
def test_a_terminal_is_wide_enough(number):
    followers = [f"learned:follower_{index}" for index in range(number)]
    lines = format_crossplay(result(["a_rather_long_changer", "b"], followers)).splitlines()
    assert max(map(len, lines)) <= WIDTH == 120
    heads = [line for line in lines if "changer  " in line and "learned:" in line]
    assert [name for head in heads for name in head.split()[1:]] == followers


def test_a_column_wider_than_the_terminal_still_shows():
    text = format_table(["name", "x" * 130, "y"], [["a", "1", "2"]], 1)
    assert [line.split() for line in text.splitlines()] == [
        ["name", "x" * 130],
        ["a", "1"],
        [],
        ["name", "y"],
        ["a", "2"],
    ]


def test_gaps():
    estimate = {"value": 12.0, "low": 10.0, "high": 14.0}
    found = {
        "entered_rate": {"value": 0.5, "low": 0.25, "high": 0.75},
        "gap_at_entry": estimate,
        "gap_change": {"value": -1.0, "low": None, "high": None},
        "gap_difference": {"value": 0.5, "low": 0.25, "high": 0.75},
    }
    text = format_gaps(
        {
            "scenario": "dense",
            "num_maneuvers": 80,
            "seed": 2,
            "maneuver": 7,
            "num_compared": 31,
            "num_entered": 29,
            "near_gap": 40.0,
            "confidence": 0.99,
            "followers": {"kind": found, "rude": found},
        }
    )
    *intro, empty, head, kind, rude = text.splitlines()
    for wanted in ("dense; 80 maneuvers", "seed 2", "maneuver 7", "31", "29", "40 m", "99 %"):
        assert wanted in "\n".join(intro)
    assert empty == ""
    assert head.startswith("followers")
    assert head.endswith("since engagement [m]  against kind [m]")
    entered, at_entry = ["50.0", "[25.0,", "75.0]"], ["12.00", "[10.00,", "14.00]"]
    assert kind.split() == ["kind", *entered, *at_entry, "-1.00", "0.50", "[0.25,", "0.75]"]
    assert rude.split()[1:] == kind.split()[1:]
    assert max(map(len, text.splitlines())) <= WIDTH


@pytest.mark.parametrize(
    ("factor", "number", "wanted"),
    [(100.0, 3, 1), (100.0, 1000, 1), (100.0, 1001, 2), (100.0, 10_000, 2), (1.0, 10_000, 1)],
)
def test_a_rate_shows_one_maneuver_of_all(factor, number, wanted):
    assert choose_decimals(1, factor, number) == wanted
    if factor == 100.0:
        assert f"{factor / number:.{wanted}f}".strip("0.") != ""
