"""Effect of the followers on many maneuvers: gaps, aborts, no collisions with the gap rule."""

import numpy as np
import pytest
import torch

from marl_lanes import Simulator, load_scenario
from marl_lanes.evaluation.gaps import NEAR_GAP, first_attempt
from marl_lanes.evaluation.rollout import run_maneuvers
from marl_lanes.naf.checkpoint import greedy_policy
from marl_lanes.traffic.machine.state import Outcome
from marl_lanes.training.checkpoint import make_network

torch.set_num_threads(1)
pytestmark = pytest.mark.slow

KINDS = ("cooperative", "neutral", "adversarial")


def prior(scenario):
    torch.manual_seed(0)
    return greedy_policy(make_network(scenario, "damped"))


def scenario_of(name, *kinds):
    followers = {"mix": dict.fromkeys(kinds, 1.0)}
    return load_scenario(name, {"num_agents": 20, "followers": followers})


def interval(values):
    """99 % interval of the mean: low, high."""
    half = 2.576 * np.std(values, ddof=1) / np.sqrt(len(values))
    return np.mean(values) - half, np.mean(values) + half


@pytest.fixture(scope="module")
def maneuvers():
    """2,000 with each kind, in the same dense traffic, with the rule that accepts narrow gaps."""
    found = {}
    for kind in KINDS:
        scenario = load_scenario(scenario_of("dense", kind), {"gap": {"rule": "kinematic"}})
        found[kind] = run_maneuvers(scenario, prior(scenario), 2000)
    return found


@pytest.fixture(scope="module")
def attempts(maneuvers):
    """First engagements with a follower within 200 m that enter the lane or abort, by kind."""
    found = {}
    for kind in KINDS:
        every = [(one.command, first_attempt(one)) for one in maneuvers[kind]]
        found[kind] = {
            (attempt.env, command, *attempt.start): attempt
            for command, attempt in every
            if attempt is not None
            and attempt.start[2] <= 200.0
            and (attempt.entry, attempt.abort) != (None, None)
        }
    return found


def gap_at_end(attempt):
    """The gap at the entry into the lane, or in the last step before the abort [m]."""
    row = attempt.entry if attempt.entry is not None else attempt.abort - 1
    return attempt.trace["follower_gap"][row]


def test_the_gap_closes_by_disposition_between_engagement_and_entry(attempts):
    """Every first attempt counts, aborted ones up to the abort.

    The mean over the entries alone does not have this order: in dense traffic the narrow gaps of
    adversarial followers end in aborts, so only the entries with wide gaps remain.
    """
    changes = {
        kind: interval([gap_at_end(one) - one.start[2] for one in attempts[kind].values()])
        for kind in KINDS
    }
    assert min(len(attempts[kind]) for kind in KINDS) > 1800
    assert changes["cooperative"][0] > changes["neutral"][1], changes
    assert changes["neutral"][0] > changes["adversarial"][1], changes


def test_the_gap_at_entry_is_ordered_where_the_engagement_is_the_same(attempts):
    """The near engagements that are equal, and enter the lane, with every kind.

    The 99 % intervals of the mean gaps do not overlap, and those of the differences are above 0.
    """
    common = set.intersection(*(set(attempts[kind]) for kind in KINDS))
    rows = [[attempts[kind][key] for kind in KINDS] for key in sorted(common)]
    rows = [row for row in rows if all(one.entry is not None for one in row)]
    gaps = np.asarray([[one.gap_at_entry for one in row] for row in rows])
    near = gaps[[row[0].start[2] < NEAR_GAP for row in rows]]
    assert len(near) > 500
    means = [interval(column) for column in near.T]
    for column in (0, 1):
        assert means[column][0] > means[column + 1][1], means
        low, high = interval(gaps[:, column] - gaps[:, column + 1])
        assert 0.5 < low < high < 3.0


def test_the_abort_rate_is_ordered(maneuvers):
    """The 99 % intervals of the share of maneuvers with an abort do not overlap."""
    aborts = {
        kind: interval([float(one.num_aborts > 0) for one in maneuvers[kind]]) for kind in KINDS
    }
    assert aborts["adversarial"][0] > aborts["neutral"][1], aborts
    assert aborts["neutral"][0] > aborts["cooperative"][1], aborts


def test_ten_thousand_guarded_maneuvers_end_without_a_collision():
    """Every middle-lane vehicle changes, among followers of every disposition."""
    counts = np.zeros(len(Outcome), np.int64)
    for name in ("dense", "paper"):
        scenario = load_scenario(
            scenario_of(name, *KINDS), {"num_agents": 40, "command": {"probability": 1.0}}
        )
        policy = prior(scenario)
        simulator = Simulator(scenario, 125, seed=1)
        simulator.reset()
        actions = np.zeros((125, simulator.num_slots, 1))
        while not simulator.roads["is_done"].all():
            engaged = simulator.is_steering
            if engaged.any():
                actions[engaged] = policy(simulator.state.observations[engaged])
            simulator.step(actions)
            counts += np.bincount(simulator.agents["outcome"].flat, minlength=len(Outcome))
        assert not simulator.roads["num_collisions"].any()
    counts[Outcome.UNFINISHED] = 0
    assert counts.sum() == 10_000
    assert counts[Outcome.COLLISION] == 0
    assert counts[Outcome.COMPLETED] > 5_000
