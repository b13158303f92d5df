"""Ratings: known odds are found again, who rams gains nothing, intervals cover."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from marl_lanes.evaluation import rating
from marl_lanes.evaluation.rating import SCALE, Match, Tally, rate, tally
from marl_lanes.traffic.machine.state import Outcome


def matches(table, num_roads=1):
    """Matches of c0, c1 ... against f0, f1 ... from the tallies of each pair, divided by roads."""
    return [
        Match(f"c{i}", f"f{j}", [Tally(*(n // num_roads for n in cell))] * num_roads)
        for i, row in enumerate(table)
        for j, cell in enumerate(row)
    ]


def rated(table, **options):
    return {one.player: one for one in rate(matches(table, **options))}


def test_ratings_give_back_the_odds_that_the_matches_were_drawn_from():
    changers, followers = np.array([1.2, -0.4]), np.array([-1.0, 0.3, -0.1])
    odds = 1.0 / (1.0 + np.exp(followers[None] - changers[:, None]))
    many = 10**6
    found = rated([[(round(many * p), round(many * (1 - p)), 0) for p in row] for row in odds])
    values = [one.rating / SCALE for one in found.values()]
    wanted = np.concatenate([changers, followers])
    assert list(found) == ["c0", "c1", "f0", "f1", "f2"]
    assert values == pytest.approx(wanted - wanted.mean(), abs=1e-3)
    assert [one.role for one in found.values()] == ["changer"] * 2 + ["followers"] * 3


def test_four_hundred_points_are_odds_of_ten_to_one():
    found = rated([[(10 * 10**6, 10**6, 0)]])
    assert found["c0"].rating - found["f0"].rating == pytest.approx(400.0, abs=0.1)


def test_a_maneuver_that_nobody_wins_costs_both():
    fair = rated([[(80, 20, 0), (80, 20, 0)], [(80, 20, 0), (80, 20, 0)]])
    rammed = rated([[(80, 20, 0), (40, 10, 50)], [(80, 20, 0), (80, 20, 0)]])
    for player in ("c0", "f1"):
        assert rammed[player].rating < fair[player].rating - 20.0
    for player in ("c1", "f0"):
        assert rammed[player].rating > fair[player].rating
    assert rammed["c0"].nobody_rate == 0.25
    assert rammed["c1"].nobody_rate == 0.0


def test_who_never_loses_has_a_rating_above_all_others():
    found = rated([[(50, 0, 0)], [(45, 5, 0)]])
    assert math.isfinite(found["c0"].rating)
    assert found["c0"].rating > found["c1"].rating > found["f0"].rating
    assert found["c0"].success_rate == 1.0
    assert found["f0"].missed_rate == 0.05


def test_intervals_narrow_with_the_number_of_roads_and_need_two(monkeypatch):
    monkeypatch.setattr(rating, "NUM_RESAMPLES", 99)
    generator = np.random.default_rng(0)

    def width(num_roads):
        won = generator.binomial(10, 0.8, (2, 2, num_roads))
        played = [
            Match(f"c{i}", f"f{j}", [Tally(int(n), 10 - int(n), 0) for n in won[i, j]])
            for i in range(2)
            for j in range(2)
        ]
        first = rate(played, seed=1)
        assert first == rate(played, seed=1)
        assert all(one.low < one.rating < one.high for one in first)
        return np.mean([one.high - one.low for one in first])

    assert 1.5 < width(8) / width(64) < 5.0
    assert rate(matches([[(8, 2, 0)]]))[0].low is None


@pytest.mark.parametrize("number", [0, 2])
def test_matches_on_other_roads_are_refused(number):
    played = [Match("c0", f"f{n}", [Tally(1, 0, 0)] * (n + 1)) for n in range(number)]
    with pytest.raises(ValueError, match="same number of roads"):
        rate(played)


def test_the_outcome_that_a_person_sees_says_who_wins(monkeypatch):
    monkeypatch.setattr(rating, "measure", lambda one, *_, **__: one)
    ends = [
        (0, Outcome.COMPLETED, True),
        (0, Outcome.MISSED, False),
        (1, Outcome.TIMED_OUT, False),
        # Completed, and lost or in a collision afterwards.
        (2, Outcome.COMPLETED, False),
        (2, Outcome.COLLISION, False),
        (2, Outcome.OFF_ROAD, False),
        (2, Outcome.HORIZON, False),
    ]
    played = [SimpleNamespace(env=e, outcome=o, is_success=s) for e, o, s in ends]
    assert tally(played, None, 4) == [(1, 1, 0), (0, 1, 0), (0, 0, 4), (0, 0, 0)]
