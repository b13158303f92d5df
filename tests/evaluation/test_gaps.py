"""The gap over time: the same maneuver with every kind of follower."""

import json

import numpy as np
import pytest

from marl_lanes import load_scenario
from marl_lanes.evaluation import gaps
from marl_lanes.evaluation.crossplay import Pair
from marl_lanes.evaluation.gaps import NEAR_GAP, compare_followers, first_attempt
from marl_lanes.evaluation.rollout import TRACE, Maneuver, run_maneuvers
from marl_lanes.traffic.machine.state import Outcome, Phase

pytestmark = pytest.mark.slow
BUSY = load_scenario(
    "paper",
    {
        "num_agents": 4,
        "departures": {"interval": [2.0, 4.0]},
        "command": {"probability": 1.0},
        "max_vehicles": 128,
        # This rule accepts narrow gaps, so there are enough comparable engagements.
        "gap": {"rule": "kinematic"},
    },
)
KINDS = ("cooperative", "neutral", "adversarial")
FOLLOWERS = {name: {"mix": {name: 1.0}} for name in KINDS}


def changing(observations):
    speed, _, deviation, yaw, yaw_rate, _ = observations.astype(np.float64).T
    steering = deviation / np.maximum(speed, 1.0) - 3.0 * (yaw + yaw_rate)
    return np.clip(steering, -0.5, 0.5)[:, None]


def never(_):
    raise AssertionError("driven, though the arguments are wrong")


def maneuver(steps, command=1, **columns):
    rows = np.zeros(len(steps), TRACE)
    rows["step"], rows["phase"], rows["follower_id"] = steps, Phase.ENGAGED, 5
    rows["follower_gap"] = 30.0 + np.arange(len(steps))
    rows["follower_gap_before"] = rows["follower_gap"] - 1.0
    for name, values in columns.items():
        rows[name] = values
    return Maneuver(3, command, 7, Outcome.MISSED, 0, 0, 0.0, 1.0, False, -2.0, rows)


def test_an_attempt_lasts_while_it_steers_before_one_and_the_same_vehicle():
    whole = first_attempt(maneuver([7, 8, 9, 10], is_over_marking=[False, False, True, True]))
    assert whole.env == 3
    assert whole.start == (7, 5, 29.0)
    assert whole.trace["step"].tolist() == [7, 8, 9, 10]
    assert (whole.entry, whole.abort, whole.gap_at_entry) == (2, None, 32.0)
    paused = first_attempt(maneuver([7, 8, 12, 13], is_over_marking=[False, False, True, True]))
    assert paused.trace["step"].tolist() == [7, 8]
    assert (paused.entry, paused.abort) == (None, None)
    assert np.isnan(paused.gap_at_entry)
    other = first_attempt(maneuver([7, 8, 9], follower_id=[5, 6, 5]))
    assert other.trace["step"].tolist() == [7]


def test_what_it_does_while_steering_back_is_no_entry():
    phases = [Phase.ENGAGED, Phase.ABORTING, Phase.ABORTING]
    found = first_attempt(maneuver([1, 2, 3], phase=phases, is_over_marking=[False, True, True]))
    assert (found.entry, found.abort) == (None, 1)


def test_no_attempt_without_an_engagement_or_a_follower():
    assert first_attempt(maneuver([])) is None
    assert first_attempt(maneuver([1, 2], follower_id=[-1, 5])) is None


@pytest.fixture
def staged(monkeypatch):
    """Six maneuvers with two kinds of follower; in the first one both enter, at 31 m and 28 m."""
    is_in = [False, True, True]

    def before(gap):
        return {"follower_gap_before": [gap, 0.0, 0.0], "is_over_marking": is_in}

    kind = [
        maneuver([1, 2, 3], 0, **before(20.5)),
        maneuver([1, 2, 3], 1, **before(50.0)),
        maneuver([1, 2, 3], 2, **before(20.0)),
        maneuver([4, 5, 6], 3, **before(25.0)),
        maneuver([4, 5, 6], 4, **before(25.0)),
        maneuver([7, 8, 9], 5, **before(25.0)),
    ]
    rude = [
        maneuver([1, 2, 3], 0, **before(20.0), follower_gap=28.0),
        maneuver([1, 2, 3], 1, **before(50.0)),
        maneuver([1, 2, 3], 2, **before(20.0), follower_id=6),
        maneuver([5, 6, 7], 3, **before(25.0)),
        maneuver([4, 5, 6], 4, **before(25.0) | {"is_over_marking": False}),
        maneuver([], 5),
    ]
    pairs = [Pair("", label, BUSY, rows) for label, rows in (("kind", kind), ("rude", rude))]
    monkeypatch.setattr(gaps, "drive_pairs", lambda *_, **__: iter(pairs))

    def compare(wanted=None):
        return compare_followers(BUSY, never, {"kind": {}, "rude": {}}, 6, maneuver=wanted)

    return compare


def test_what_is_shown_is_the_same_until_it_engages(staged):
    assert staged()["maneuver"] == staged(4)["maneuver"] == 4
    assert staged(1)["maneuver"] == 1
    # Another gap, another vehicle, another step, no engagement.
    for other in (0, 2, 3, 5):
        with pytest.raises(ValueError, match=rf"maneuver = {other}: must .* that do: 1, 4$"):
            staged(other)
    kind, rude = (staged()["followers"][name]["shown"] for name in ("kind", "rude"))
    assert kind["gap"] == [25.0, 30.0, 31.0, 32.0]
    assert kind["entry_time"] == pytest.approx(0.2)
    assert rude["entry_time"] is kind["abort_time"] is None


def test_what_is_compared_engages_in_the_same_step_before_the_same_vehicle_nearby(staged):
    found = staged()
    assert (found["num_compared"], found["num_entered"]) == (2, 1)
    kind, rude = (found["followers"][name] for name in ("kind", "rude"))
    assert (kind["entered_rate"]["value"], rude["entered_rate"]["value"]) == (1.0, 0.5)
    assert (kind["gap_at_entry"]["value"], rude["gap_at_entry"]["value"]) == (31.0, 28.0)
    assert (kind["gap_change"]["value"], rude["gap_change"]["value"]) == (10.5, 8.0)
    assert (kind["gap_difference"]["value"], rude["gap_difference"]["value"]) == (0.0, -3.0)


@pytest.fixture(scope="module")
def compared():
    return compare_followers(BUSY, changing, FOLLOWERS, 160, seed=3)


def test_the_same_maneuver_is_shown(compared):
    shown = [compared["followers"][name]["shown"] for name in KINDS]
    assert compared["seed"] == 3
    starts = {one["gap"][0] for one in shown}
    assert len(starts) == 1
    assert 0.0 < starts.pop() < NEAR_GAP
    for one in shown:
        assert one["time"] == pytest.approx(0.1 * np.arange(len(one["gap"])))
        assert len(one["follower_acceleration"]) == len(one["gap"])
        assert one["follower_acceleration"][0] is None
    kind, none, rude = (one["follower_acceleration"][1] for one in shown)
    assert kind <= none < rude
    assert json.loads(json.dumps(compared, allow_nan=False)) == compared


def test_the_curves_are_those_of_the_trace(compared):
    index = compared["maneuver"]
    for name in KINDS:
        scenario = load_scenario(BUSY, {"followers": FOLLOWERS[name]})
        trace = run_maneuvers(scenario, changing, index + 1, seed=3)[index].trace
        shown = compared["followers"][name]["shown"]
        count = len(shown["gap"]) - 1
        assert shown["gap"][1:] == trace["follower_gap"][:count].tolist()
        assert shown["follower_acceleration"][1:] == trace["follower_acceleration"][:count].tolist()
        entry = int(trace["is_over_marking"].argmax())
        assert shown["entry_time"] == pytest.approx(0.1 * (entry + 1))
        if count > entry:
            assert trace["step"][entry] - trace["step"][0] == entry


def test_kind_followers_open_the_gap_and_rude_ones_close_it(compared):
    """Over the same engagements; means over different ones would not be comparable."""
    kind, none, rude = (compared["followers"][name] for name in KINDS)
    assert 20 < compared["num_entered"] <= compared["num_compared"] < 100
    for key in ("gap_at_entry", "gap_change"):
        assert kind[key]["value"] > none[key]["value"] > rude[key]["value"]
        for found in (kind, none, rude):
            assert found[key]["low"] < found[key]["value"] < found[key]["high"]
    # The paired difference is significant, although the intervals of the means overlap.
    assert kind["gap_difference"] == {"value": 0.0, "low": 0.0, "high": 0.0}
    assert none["gap_difference"]["high"] < 0.0
    assert rude["gap_difference"]["high"] < none["gap_difference"]["low"]
    for found in (none, rude):
        difference = found["gap_at_entry"]["value"] - kind["gap_at_entry"]["value"]
        assert found["gap_difference"]["value"] == pytest.approx(difference)
    assert kind["entered_rate"]["value"] >= none["entered_rate"]["value"]
    assert none["entered_rate"]["value"] > rude["entered_rate"]["value"] > 0.5


def test_one_kind_is_compared_with_itself():
    one = {"a": FOLLOWERS["neutral"], "b": FOLLOWERS["neutral"]}
    found = compare_followers(BUSY, changing, one, 20, seed=3)
    assert found["followers"]["a"] == found["followers"]["b"]
    assert found["num_compared"] > 0


def test_a_wanted_maneuver_is_shown(compared):
    number = compared["maneuver"] + 1
    found = compare_followers(
        BUSY, changing, FOLLOWERS, number, seed=3, maneuver=compared["maneuver"]
    )
    for name in KINDS:
        assert found["followers"][name]["shown"] == compared["followers"][name]["shown"]


def test_a_maneuver_that_differs_before_it_engages_is_refused():
    """On a road the last maneuvers depend on what earlier followers did."""
    refused = {}
    for index in (7, 6, 5):
        try:
            found = compare_followers(BUSY, changing, FOLLOWERS, 8, seed=3, maneuver=index)
            assert found["maneuver"] == index
        except ValueError as error:
            refused[index] = str(error)
            break
    assert len(refused) == 1
    for index, message in refused.items():
        assert message.startswith(f"maneuver = {index}: must engage with a vehicle behind")
        assert "; maneuvers that do: " in message


@pytest.mark.parametrize(
    ("arguments", "options", "message"),
    [
        ((FOLLOWERS, 0), {}, "num_maneuvers = 0: must be at least 1"),
        ((FOLLOWERS, 5), {"maneuver": 5}, "maneuver = 5: must be 0 to 4"),
        ((FOLLOWERS, 5), {"maneuver": -1}, "maneuver = -1: must be 0 to 4"),
        (({}, 5), {}, "followers: must have at least one entry"),
        (({"x": {"mix": {"unknown": 1.0}}}, 5), {}, "unknown"),
    ],
)
def test_bad_arguments_are_refused_before_anything_is_driven(arguments, options, message):
    with pytest.raises(ValueError, match=message):
        compare_followers(BUSY, never, *arguments, **options)


def test_traffic_without_a_near_follower_is_refused():
    few = {"departures": {"interval": [60.0, 61.0]}, "command": {"probability": 1.0}}
    sparse = load_scenario("paper", {"num_agents": 1} | few)
    with pytest.raises(ValueError, match=r"none of 2 maneuvers engages with a follower nearer"):
        compare_followers(sparse, changing, FOLLOWERS, 2)
