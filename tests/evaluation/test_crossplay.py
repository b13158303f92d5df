"""Cross-play: every pair on the same traffic, its statistics, and errors before the start."""

import json

import numpy as np
import pytest

from marl_lanes import ScenarioError, load_scenario
from marl_lanes.evaluation.crossplay import EXTREMES, MEANS, RATES, crossplay, drive_pairs, estimate
from marl_lanes.evaluation.metrics import evaluate
from marl_lanes.evaluation.policies import make_lane_keeping_policy
from marl_lanes.evaluation.rollout import run_maneuvers

BUSY = load_scenario(
    "paper",
    {
        "num_agents": 5,
        "departures": {"interval": [2.0, 4.0]},
        "command": {"probability": 1.0},
        "road": {"length": 600.0},
        "max_vehicles": 128,
    },
)
FOLLOWERS = {name: {"mix": {name: 1.0}} for name in ("cooperative", "adversarial")}


def never(_):
    raise AssertionError("driven, though the arguments are wrong")


def changing(observations):
    speed, _, deviation, yaw, yaw_rate, _ = observations.astype(np.float64).T
    steering = deviation / np.maximum(speed, 1.0) - 3.0 * (yaw + yaw_rate)
    return np.clip(steering, -0.5, 0.5)[:, None]


def changers(*, scenario=BUSY):
    return {
        "keeping": (scenario, make_lane_keeping_policy(scenario)),
        "changing": (scenario, changing),
    }


@pytest.fixture(scope="module")
def table():
    return crossplay(changers(), FOLLOWERS, 60, seed=2)


def statistics(table, changer, follower):
    (found,) = [
        pair["statistics"]
        for pair in table["pairs"]
        if (pair["changer"], pair["followers"]) == (changer, follower)
    ]
    return found


def test_every_pair_is_in_the_table(table):
    names = [(pair["changer"], pair["followers"]) for pair in table["pairs"]]
    assert names == [(one, other) for one in ("keeping", "changing") for other in FOLLOWERS]
    assert {pair["num_maneuvers"] for pair in table["pairs"]} == {60}
    assert {pair["num_roads"] for pair in table["pairs"]} == {12}
    assert (table["seed"], table["num_maneuvers"], table["confidence"]) == (2, 60, 0.95)
    assert table["changers"] == {"keeping": "paper", "changing": "paper"}
    assert table["followers"] == FOLLOWERS
    assert json.loads(json.dumps(table, allow_nan=False)) == table


@pytest.mark.parametrize("follower", FOLLOWERS)
def test_the_statistics_are_the_metrics(table, follower):
    """The statistics are those of the pair's maneuvers, simulated separately."""
    scenario = load_scenario(BUSY, {"followers": FOLLOWERS[follower]})
    maneuvers = run_maneuvers(scenario, changing, 60, seed=2)
    summary = evaluate(maneuvers, scenario, with_optimum=False)
    found = statistics(table, "changing", follower)
    assert set(found) == {*RATES, *MEANS, *EXTREMES}
    for key, one in found.items():
        assert one["value"] == summary[key], key
        if key in EXTREMES:
            assert one["low"] is one["high"] is None
        else:
            assert one["low"] <= one["value"] <= one["high"], key
    assert found == estimate(maneuvers, scenario, seed=2)


def test_what_followers_do_shows_beyond_chance(table):
    """A changer that keeps its lane stays engaged until the adversary makes it abort."""
    kind, rude = (statistics(table, "keeping", name) for name in FOLLOWERS)
    assert kind["abort_rate"]["high"] < rude["abort_rate"]["low"]
    assert rude["abort_rate"]["value"] > 0.5
    for found in (kind, rude):
        assert found["completion_rate"]["value"] == 0.0
        assert found["completion_rate"]["high"] == pytest.approx(1.0 - 0.025 ** (1.0 / 60.0))
        assert found["mean_time_to_completion"] == {"value": None, "low": None, "high": None}
    changed = statistics(table, "changing", "cooperative")["completion_rate"]
    assert changed["low"] > kind["completion_rate"]["high"]


def test_one_abort_or_one_miss_counts_once(table):
    for pair in table["pairs"]:
        found = {key: pair["statistics"][key]["value"] for key in RATES}
        both = found["abort_or_miss_rate"]
        assert max(found["abort_rate"], found["missed_rate"]) <= both
        assert both <= found["abort_rate"] + found["missed_rate"]
    keeping = statistics(table, "keeping", "adversarial")
    assert keeping["abort_or_miss_rate"]["value"] < 1.5
    assert keeping["abort_rate"]["value"] + keeping["missed_rate"]["value"] > 1.5


def test_the_shares_of_what_ended_the_commands_add_up_whatever_ends_them():
    limits = {"num_agents": 10, "horizon": 15.0, "command": {"time_limit": 5.0}}
    scenario = load_scenario(BUSY, limits)
    found = estimate(run_maneuvers(scenario, changing, 20, seed=2), scenario)
    ends = ("completion", "missed", "timed_out", "horizon", "collision", "off_road")
    shares = [found[f"{name}_rate"]["value"] for name in ends]
    assert sum(shares) == pytest.approx(1.0)
    assert shares[2] > 0.0
    assert shares[3] > 0.0


@pytest.mark.slow
def test_all_pairs_meet_the_same_traffic():
    """Until they act differently, so the first command of a road is in the same step."""
    pairs = list(drive_pairs(changers(), FOLLOWERS, 10, seed=4))
    assert len(pairs) == 4
    first = [
        [(one.env, one.born_step) for one in pair.maneuvers if one.command == 0] for pair in pairs
    ]
    assert len(first[0]) == 2
    assert first[0] == first[1] == first[2] == first[3]
    (other, *_) = drive_pairs(changers(), FOLLOWERS, 10, seed=5)
    assert [(one.env, one.born_step) for one in other.maneuvers if one.command == 0] != first[0]


@pytest.mark.slow
def test_a_pair_does_not_depend_on_the_others():
    alone = crossplay({"x": (BUSY, changing)}, {"rude": FOLLOWERS["adversarial"]}, 10, seed=4)
    among = crossplay(changers(), FOLLOWERS, 10, seed=4)
    assert alone["pairs"][0]["statistics"] == statistics(among, "changing", "adversarial")


def test_changers_may_have_scenarios_of_their_own():
    other = load_scenario(
        BUSY, {"name": "short", "action": {"max_yaw_acceleration": 0.25}, "num_agents": 2}
    )
    found = crossplay({"one": (BUSY, changing), "two": (other, changing)}, FOLLOWERS, 4)
    assert found["changers"] == {"one": "paper", "two": "short"}
    assert [pair["scenario"] for pair in found["pairs"]] == ["paper"] * 2 + ["short"] * 2
    assert [pair["num_roads"] for pair in found["pairs"]] == [1, 1, 2, 2]


def test_a_given_follower_drives():
    """Drivers that brake behind every engaged changer."""
    speeds = []

    def brake(observations):
        speeds.extend(observations[:, 0])
        return np.full(len(observations), -3.0)

    found = crossplay(
        {"one": (BUSY, changing)},
        {"braking": {"mix": {"braker": 1.0}}, "neutral": {"mix": {"neutral": 1.0}}},
        20,
        follower_policies={"braker": brake},
    )
    assert len(speeds) > 20
    braking, neutral = (pair["statistics"] for pair in found["pairs"])
    key = "mean_max_follower_braking_all"
    assert braking[key]["value"] > 2.5
    assert braking != neutral


def test_progress_rises_over_all_pairs():
    counts = []
    crossplay(changers(), FOLLOWERS, 3, progress=counts.append)
    assert counts == sorted(counts)
    assert set(counts) >= {3, 6, 9, 12}
    assert counts[-1] == 12


@pytest.mark.parametrize(
    ("given", "followers", "number", "message"),
    [
        ({"x": (BUSY, never)}, FOLLOWERS, 0, "num_maneuvers = 0: must be at least 1"),
        ({}, FOLLOWERS, 1, "changers: must have at least one entry"),
        ({"x": (BUSY, never)}, {}, 1, "followers: must have at least one entry"),
        ({"x": (BUSY, never)}, {**FOLLOWERS, "y": {"mix": {"unknown": 1.0}}}, 1, "unknown"),
        ({"x": (BUSY, never)}, {**FOLLOWERS, "y": {"mixture": {}}}, 1, "followers.mixture"),
        (
            {"x": (BUSY, never)},
            {**FOLLOWERS, "y": {"mix": {"learned": 1}, "learned": {"checkpoint": "absent.pt"}}},
            1,
            "absent.pt",
        ),
        ({"x": (load_scenario("paper", {"num_agents": None}), never)}, FOLLOWERS, 1, "num_agents"),
    ],
)
def test_bad_arguments_are_refused_before_anything_is_driven(given, followers, number, message):
    with pytest.raises(ValueError, match=message):
        crossplay(given, followers, number, progress=never)
    if message in {"unknown", "followers.mixture", "num_agents"}:
        with pytest.raises(ScenarioError, match=message):
            crossplay(given, followers, number)
