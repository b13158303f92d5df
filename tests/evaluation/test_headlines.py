"""The headline numbers: the same as the metrics', with intervals over roads, all documented."""

import re
from pathlib import Path

import pytest
from evaluation.test_metrics import PAPER, sample

from marl_lanes.evaluation.headlines import HEADLINES, estimate_headlines
from marl_lanes.evaluation.intervals import estimate_mean
from marl_lanes.evaluation.metrics import measure_each, summarise

METRICS = Path(__file__).parents[2] / "docs" / "metrics.md"


def test_the_values_are_those_of_the_metrics():
    measured, no_optimum = measure_each(sample(), PAPER)
    summary = summarise(measured, no_optimum=no_optimum)
    found = estimate_headlines(measured, [0, 0, 1, 1])
    assert list(found) == [headline.key for headline in HEADLINES]
    assert found["success_rate"]["value"] == 0.25
    assert found["cost_ratio"]["value"] > 1.0
    for key, estimate in found.items():
        value = summary[key]
        assert estimate["value"] == (value if value is None else pytest.approx(value)), key


def test_the_roads_are_the_groups():
    measured, _ = measure_each(sample() * 5, PAPER, with_optimum=False)
    roads = [index // 4 for index in range(20)]
    aborted = [1.0, 1.0, 0.0, 0.0] * 5
    wanted = estimate_mean(aborted, roads, is_rate=True)
    found = estimate_headlines(measured, roads)["abort_rate"]
    assert (found["low"], found["high"]) == (wanted.low, wanted.high) == (0.5, 0.5)
    spread = estimate_headlines(measured, list(range(20)))["abort_rate"]
    assert spread["low"] < 0.5 < spread["high"]


def test_every_headline_is_a_documented_metric_and_one_sentence():
    documented = set(re.findall(r"`(\w+)`", METRICS.read_text(encoding="utf-8")))
    for headline in HEADLINES:
        assert headline.key in documented
        assert headline.meaning.endswith(".")
        assert headline.is_rate == headline.key.endswith("_rate")
