"""Where a training's time goes: the parts, their sum, and that each is counted as what it is."""

import time

import pytest
import torch
from training.test_learner import Evaluation, changers

from marl_lanes.training.timing import ACTIVITIES, OTHER, format_split, split_time

torch.set_num_threads(1)
pytestmark = pytest.mark.filterwarnings(
    "ignore:Creating .* which inherits from WeightUpdaterBase:DeprecationWarning"
)


def test_the_split_sums_up():
    parts = dict(zip(ACTIVITIES.values(), (2.0, 1.0, 0.5, 3.0, 1.0), strict=True))
    split = split_time({**parts, "seconds_training": 8.0}, 1_000_000)
    assert list(split) == [*ACTIVITIES, OTHER]
    assert split["simulate"] == (2.0, 0.25)
    assert split[OTHER] == (0.5, 0.0625)
    assert sum(share for _, share in split.values()) == 1.0
    lines = format_split(split).splitlines()
    assert lines[1].split() == ["simulate", "2.00", "25.0%"]
    assert lines[-1].split() == ["sum", "8.00", "100.0%"]


SLOW = 1000.0


class Clock:
    """The true time, and SLOW seconds more for each call of a method that is slowed."""

    def __init__(self, monkeypatch):
        true = time.perf_counter
        self.num_calls = 0
        monkeypatch.setattr(time, "perf_counter", lambda: true() + SLOW * self.num_calls)

    def slow(self, owner, name):
        method = getattr(owner, name)

        def slowed(*args, **kwargs):
            self.num_calls += 1
            return method(*args, **kwargs)

        setattr(owner, name, slowed)


@pytest.mark.training
def test_the_parts_are_the_whole(tmp_path):
    learner = changers()
    learner.begin(tmp_path / "run")
    start = time.perf_counter()
    assert learner.train(Evaluation())
    elapsed = time.perf_counter() - start
    learner.close()
    counters = learner.counters
    assert sum(share for _, share in learner.split.values()) == pytest.approx(1.0)
    # Nothing is counted twice: what is left over is not negative, nor is any part.
    assert all((value > 0.0) == (part != "wait") for part, (value, _) in learner.split.items())
    inside = counters["seconds_simulating"] + counters["seconds_acting"]
    assert inside < counters["seconds_collecting"]
    total = sum(value for value, _ in learner.split.values()) * learner.transitions * 1e-6
    assert total == pytest.approx(counters["seconds_training"])
    assert total + counters["seconds_evaluating"] < elapsed


@pytest.mark.training
@pytest.mark.parametrize("activity", ["simulate", "act", "store", "learn", OTHER, "evaluate"])
def test_each_is_counted_as_what_it_is(tmp_path, monkeypatch, activity):
    clock = Clock(monkeypatch)
    learner = changers()
    learner.begin(tmp_path / "run")
    evaluation = Evaluation()
    owner, name = {
        "simulate": (learner.env.simulator, "step"),
        "act": (learner.policy[0], "forward"),
        "store": (learner.experience, "extend"),
        "learn": (learner.algorithm.optimizer, "step"),
        OTHER: (learner, "log"),
        "evaluate": (learner, "save_model"),
    }[activity]
    clock.slow(owner, name)
    assert learner.train(evaluation)
    learner.close()
    assert clock.num_calls > 1
    seconds = {
        part: value * learner.transitions * 1e-6 for part, (value, _) in learner.split.items()
    }
    seconds["evaluate"] = learner.counters["seconds_evaluating"]
    for part, value in seconds.items():
        wanted = clock.num_calls if part == activity else 0
        assert round(value / SLOW) == wanted, part
