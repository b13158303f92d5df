"""Phases of followers and changers: who is evaluated with whom, and what ends them."""

import pytest
import torch
from adversary_program import FOLDER, PAPER, TINY, prepare
from programs import load_program

from marl_lanes import interplay
from marl_lanes.interplay import Grounds, Opponent, Phase, carry_out, changer_phase, follower_phase
from marl_lanes.traffic.roles.follower import FOLLOWER
from marl_lanes.training.checkpoint import make_network
from marl_lanes.training.opponents import PoolPolicy

torch.set_num_threads(1)
pytestmark = pytest.mark.training


@pytest.fixture
def grounds(tmp_path, monkeypatch):
    monkeypatch.chdir(prepare(tmp_path))
    return Grounds(load_program(FOLDER / "train.py").read(TINY), "cooperative")


@pytest.fixture
def driven(monkeypatch):
    """What the evaluations drive: name, number of maneuvers, mix; nothing is simulated."""
    calls = []

    def record(path, name, scenario, _, number, **__):
        calls.append((path, name, number, dict(scenario.followers.mix)))
        return [name] * number

    monkeypatch.setattr(interplay, "record_maneuvers", record)
    monkeypatch.setattr(interplay, "evaluate", lambda maneuvers, *_, **__: {"of": maneuvers})
    return calls


def test_a_follower_may_be_chosen_by_either_of_the_ways_in_which_it_wins():
    assert {"missed_rate", "timed_out_rate"} <= set(interplay.ChangerEvaluationConfig.metrics)


def changer():
    return make_network(PAPER, "damped", [8])


def test_a_follower_meets_each_changer_on_its_share_of_the_roads(grounds, driven, tmp_path):
    opponents = [Opponent("a", changer(), 0.25), Opponent("b", changer(), 0.0)]
    opponents.append(Opponent("c", changer(), 0.75))
    config = grounds.config.follower
    evaluation = config.evaluation.model_copy(update={"num_maneuvers": 8})
    follower = config.model_copy(update={"evaluation": evaluation})
    grounds.config = grounds.config.model_copy(update={"follower": follower})
    phase = follower_phase(grounds, opponents, number=0)
    network = make_network(PAPER, "mlp", [8], role=FOLLOWER)
    assert phase.evaluate_model(network, tmp_path / "x") == {"of": ["a"] * 2 + ["c"] * 6}
    # One file, of the first one.
    alone = {"learned": 1.0}
    assert driven == [(tmp_path / "x", "a", 2, alone), (None, "c", 6, alone)]
    learner = phase.make_learner()
    (pool,) = [part for part in learner.policy.modules() if isinstance(part, PoolPolicy)]
    assert torch.bincount(pool.driver, minlength=3).tolist() == [4, 0, 12]
    assert learner.group == "followers"
    # What it is paid for is the run's objective.
    assert learner.env.scenario.followers.learned.objective == "cooperative"
    learner.collector.shutdown()


def test_a_changer_learns_among_those_that_it_meets(grounds, driven):
    mix = {"neutral": 0.25, "cooperative": 0.0, "follower_1": 0.75}
    policies = {"follower_1": lambda seen: seen[:, 0] * 0.0}
    phase = changer_phase(grounds, grounds.config.follower, changer, mix, policies, number=1)
    phase.evaluate_model(changer(), None)
    assert driven == [(None, "", 2, {"neutral": 0.25, "follower_1": 0.75})]
    learner = phase.make_learner()
    assert dict(learner.env.scenario.followers.mix) == {"neutral": 0.25, "follower_1": 0.75}
    assert learner.group == "changers"
    learner.collector.shutdown()


def test_phases_have_seeds_of_their_own(grounds):
    seeds = [grounds.seed(number) for number in range(4)]
    assert len(set(seeds)) == 4
    assert torch.initial_seed() == seeds[-1]
    assert grounds.seed(0) == seeds[0]


def test_a_finished_phase_is_left_alone(tmp_path):
    (tmp_path / "training.json").touch()
    phase = Phase(lambda: pytest.fail("a learner was made"), lambda *_: {})
    assert carry_out(phase, tmp_path, is_begun=True)
