"""Rows of a comparison: success of each seed, what counts as good, decisions, the table."""

import numpy as np

from marl_lanes import load_scenario
from marl_lanes.evaluation.comparison import (
    COLUMNS,
    format_comparison,
    is_good,
    measure,
    summarise,
    write_rows,
)
from marl_lanes.evaluation.policies import make_tuned_cascade_policy


def test_the_success_of_each_seed_is_shown():
    """A mean hides that some seeds have not learned it."""
    columns = {key: [0.5] for key, *_ in COLUMNS} | {"return": [-4.0], "road": [0]}
    columns["optimal_return"] = [-4.0]
    figures = {"microseconds_of_1": 1.0, "microseconds_of_64": 1.0, "transitions_to_good": None}
    figures |= {"transitions": 100, "training_seconds": 1.0}
    found = [{"maneuvers": columns | {"success_rate": [rate]}, **figures} for rate in (1.0, 0.0)]
    row = summarise("ippo", "100 transitions", found)
    assert row["success_of_seeds"] == [1.0, 0.0]
    header, _, line = format_comparison([row]).splitlines()
    place = header.split(" | ").index("by seed")
    assert line.split(" | ")[place] == "100.0, 0.0"
    assert line.split(" | ")[place - 1].startswith("50.0 [")


def test_a_policy_is_good_only_if_it_succeeds_and_is_cheap():
    """A low cost of the few changes that are completed is none."""
    found = {"return": [-4.0, -5.0], "optimal_return": [-4.0, -4.0], "road": [0, 1]}
    assert not is_good(found | {"success_rate": (1.0, 0.0)})
    dear = found | {"success_rate": (1.0, 1.0), "return": [-5.0, None]}
    assert [is_good(dear | {"return": [-4.5, cost]}) for cost in (None, -4.7, -4.8)] == [
        True,
        True,
        False,
    ]


def test_what_is_measured_of_a_policy(tmp_path):
    scenario = load_scenario("paper")
    found = measure(make_tuned_cascade_policy(scenario), scenario, 4, 1)
    columns = found["maneuvers"]
    assert columns["success_rate"] == [1.0] * 4
    assert len(set(map(len, columns.values()))) == 1
    assert np.all(np.array(columns["return"]) <= columns["optimal_return"])
    assert min(found[f"microseconds_of_{size}"] for size in (1, 64)) > 0.0
    row = summarise("tuned-cascade", "", [found])
    ratio = sum(columns["return"]) / sum(columns["optimal_return"])
    assert row["cost_ratio"]["value"] == ratio
    write_rows(tmp_path / "rows.csv", [row])
    head, line = (tmp_path / "rows.csv").read_text("utf-8").splitlines()
    assert line.split(",")[head.split(",").index("cost_ratio_value")] == str(ratio)
