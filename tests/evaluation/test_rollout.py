"""Maneuvers on seeded traffic: selection, order, and recorded values."""

import numpy as np
import pytest
import torch

from marl_lanes import ScenarioError, load_scenario, parallel_env
from marl_lanes.evaluation.measures import measure
from marl_lanes.evaluation.metrics import evaluate
from marl_lanes.evaluation.rollout import run_maneuvers
from marl_lanes.naf.checkpoint import greedy_policy
from marl_lanes.traffic.machine.state import Outcome, Phase
from marl_lanes.training.checkpoint import make_network

torch.set_num_threads(1)
QUICK = {
    "num_agents": 5,
    "warmup": [20.0, 30.0],
    "departures": {"interval": [1.5, 3.0]},
    "command": {"probability": 1.0},
    "gap": {"rule": "kinematic", "minimum_gap": 0.5, "time_gap": 0.1},
}
ADVERSARIAL = load_scenario("adversarial", QUICK)


def slowly(observations):
    """Slow feedback toward the reference lane, so that the gap rule makes some agents abort."""
    speed, _, deviation, yaw, yaw_rate, curvature = observations.astype(np.float64).T
    wanted = np.clip(0.3 * deviation, -0.8, 0.8) / np.maximum(speed, 1.0)
    action = 2.0 * (wanted - yaw) - 2.0 * (yaw_rate - curvature * speed)
    rough = speed % 5.0 < 0.7
    return np.where(rough, 0.5, np.clip(action, -0.5, 0.5))[:, None]


@pytest.fixture(scope="module")
def driven():
    return run_maneuvers(ADVERSARIAL, slowly, 58, seed=3)


def key(maneuver):
    return maneuver.env, maneuver.command


def test_the_first_commands_in_the_order_of_road_and_command(driven):
    assert [key(one) for one in driven] == [divmod(index, 5) for index in range(58)]
    fewer = run_maneuvers(ADVERSARIAL, slowly, 7, seed=3)
    assert [key(one) for one in fewer] == [divmod(index, 5) for index in range(7)]
    for one, other in zip(fewer, driven, strict=False):
        assert one.outcome == other.outcome
        assert one.trace.tobytes() == other.trace.tobytes()


@pytest.mark.slow
def test_a_seed_gives_the_same_maneuvers(driven):
    again = run_maneuvers(ADVERSARIAL, slowly, 58, seed=3)
    assert [repr(one) for one in again] == [repr(one) for one in driven]
    assert all(
        one.trace.tobytes() == other.trace.tobytes()
        for one, other in zip(again, driven, strict=True)
    )
    other = run_maneuvers(ADVERSARIAL, slowly, 58, seed=4)
    assert [one.born_step for one in other] != [one.born_step for one in driven]


def test_maneuvers_are_those_of_the_environment(driven):
    """Road 0 against the PettingZoo environment: returns, outcomes, lives."""
    env = parallel_env(ADVERSARIAL, seed=0)
    observations, infos = env.reset(seed=3)
    returns = dict.fromkeys(env.possible_agents, 0.0)
    outcomes, aborts, steered = {}, {}, dict.fromkeys(env.possible_agents, 0)
    phases = {agent: info["phase"] for agent, info in infos.items()}
    while env.agents:
        for agent in env.agents:
            steered[agent] += phases[agent] >= Phase.ENGAGED
        actions = {agent: slowly(observations[agent][None])[0] for agent in env.agents}
        observations, rewards, _, _, infos = env.step(actions)
        for agent, reward in rewards.items():
            returns[agent] += reward
            outcomes[agent] = infos[agent]["outcome"]
            aborts[agent] = infos[agent]["num_aborts"]
            phases[agent] = infos[agent]["phase"]
    for one in driven[:5]:
        agent = f"changer_{one.command}"
        assert one.outcome == outcomes[agent]
        assert one.num_aborts == aborts[agent]
        assert len(one.trace) == steered[agent]
        penalty = -10.0 if one.outcome in {Outcome.COLLISION, Outcome.OFF_ROAD} else 0.0
        found = measure(one, ADVERSARIAL, with_optimum=False).return_
        assert found + penalty == pytest.approx(returns[agent], abs=1e-4)
        assert one.episode_reward == pytest.approx(returns[agent], abs=1e-4)


def test_traces_are_of_steering_steps_and_times_add_up(driven):
    assert any(one.num_aborts for one in driven)
    step = ADVERSARIAL.time_step
    for one in driven:
        steps, phase = one.trace["step"], one.trace["phase"]
        assert set(phase) <= {Phase.ENGAGED, Phase.ABORTING}
        assert (np.diff(steps) > 0).all()
        turns = (np.diff(phase) > 0).sum()
        assert turns <= one.num_aborts <= turns + 1
        end = one.born_step + round(one.time_to_end / step)
        if not len(steps):
            assert one.waiting_time == one.time_to_end
            continue
        # Engaged at the end of a step, it acts in the next.
        assert one.waiting_time == pytest.approx((steps[0] - 1 - one.born_step) * step)
        assert steps[-1] <= end
        if one.outcome in {Outcome.COMPLETED, Outcome.OFF_ROAD}:
            assert steps[-1] == end
        assert (np.diff(steps) > 1).sum() <= one.num_aborts


def test_columns_before_a_step_are_those_after_the_last(driven):
    rows = max(driven, key=lambda one: len(one.trace)).trace
    assert len(rows) > 20
    together = (np.diff(rows["step"]) == 1) & (rows["phase"][1:] == rows["phase"][:-1])
    assert together.sum() > 20
    for before, after in (
        ("deviation_before", "lateral_deviation"),
        ("yaw_before", "yaw"),
        ("yaw_rate_before", "yaw_rate"),
    ):
        assert rows[before][1:][together] == pytest.approx(rows[after][:-1][together])
    dt = ADVERSARIAL.time_step
    rates = rows["yaw_rate_before"] + dt * rows["yaw_acceleration"]
    assert rows["yaw_rate"] == pytest.approx(rates)
    deviation = -0.05 * np.abs(rows["lateral_deviation"]) / 1.875
    assert rows["reward_deviation"] == pytest.approx(deviation)
    assert rows["reward_yaw_acceleration"] == pytest.approx(-2.0 * np.abs(rows["yaw_acceleration"]))


def test_what_is_recorded_of_the_vehicle_and_of_its_follower(driven):
    """Speed is the last one plus dt times the acceleration; a gap is to one vehicle."""
    dt = ADVERSARIAL.time_step
    checked = 0
    for one in driven:
        rows = one.trace
        if not len(rows):
            continue
        assert ((rows["follower_id"] == -1) == np.isinf(rows["follower_gap"])).all()
        together = np.diff(rows["step"]) == 1
        moving = together & (rows["speed"][1:] > 0.0)
        speeds = rows["speed"][:-1] + dt * rows["acceleration"][1:]
        assert rows["speed"][1:][moving] == pytest.approx(speeds[moving])
        same = together & (np.diff(rows["follower_id"]) == 0) & (rows["follower_id"][1:] >= 0)
        gaps = rows["follower_gap_before"][1:], rows["follower_gap"][:-1]
        assert gaps[0][same] == pytest.approx(gaps[1][same])
        checked += same.sum()
    assert checked > 200


def test_neighbors_are_those_of_both_lanes(driven):
    """Bodies in a lane, and the braking that the change imposes on follower and changer."""
    rows = np.concatenate([one.trace for one in driven])
    assert (rows["is_in_origin"] | rows["is_over_marking"]).all()
    assert (rows["is_in_origin"] & rows["is_over_marking"]).any()
    assert (~rows["is_in_origin"]).any()
    for side in ("leader", "follower"):
        assert ((rows[f"{side}_id"] < 0) == np.isinf(rows[f"{side}_gap"])).all()
        for name in (side, f"origin_{side}"):
            is_there = np.isfinite(rows[f"{name}_gap"])
            assert is_there.any()
            assert (np.isnan(rows[f"{name}_speed"]) == ~is_there).all()
    is_held = np.isfinite(rows["imposed_on_follower"])
    assert ((rows["follower_gap_before"] < np.inf) == is_held).all()
    for name in ("imposed_on_changer", "imposed_on_follower"):
        imposed = rows[name][is_held]
        assert (imposed >= 0.0).all()
        assert 0.01 < (imposed > 0.0).mean() < 0.9, name
    braking = np.maximum(0.0, -rows["acceleration"])
    assert (rows["imposed_on_changer"] <= braking + 1e-12).all()
    for one in driven:
        trace = one.trace
        together = np.diff(trace["step"]) == 1
        before = trace["acceleration_before"][1:][together]
        assert before == pytest.approx(trace["acceleration"][:-1][together])
        moved = np.diff(trace["position"])[together]
        assert moved == pytest.approx((trace["speed"] * np.cos(trace["yaw"]))[1:][together] * 0.1)


def test_outcomes_are_counted(driven):
    summary = evaluate(driven, ADVERSARIAL, with_optimum=False)
    outcomes = [one.outcome for one in driven]
    assert len(set(outcomes)) >= 2
    for name in ("COMPLETED", "COLLISION", "MISSED", "OFF_ROAD", "HORIZON"):
        rate = {"COMPLETED": "completion"}.get(name, name.lower())
        assert summary[f"{rate}_rate"] == outcomes.count(Outcome[name]) / 58
    assert summary["abort_rate"] == sum(one.num_aborts > 0 for one in driven) / 58 > 0
    for one in driven:
        assert (one.aftermath is not None) == (one.outcome == Outcome.COMPLETED)
    assert any(one.aftermath is not None for one in driven)


def test_with_too_little_time_every_command_times_out_and_none_is_missed():
    limit = {"command": {**QUICK["command"], "time_limit": 2.0}}
    hasty = load_scenario("adversarial", {**QUICK, **limit})
    driven = run_maneuvers(hasty, slowly, 10, seed=3)
    assert {one.outcome for one in driven} == {Outcome.TIMED_OUT}
    assert {one.time_to_end for one in driven} == {2.0}
    summary = evaluate(driven, hasty, with_optimum=False)
    rates = [summary[f"{name}_rate"] for name in ("success", "timed_out", "missed", "horizon")]
    assert rates == [0.0, 1.0, 0.0, 0.0]


@pytest.mark.parametrize("name", ["paper", "touch", "curved"])
def test_no_maneuver_is_cheaper_than_its_optimum(name):
    scenario = load_scenario(name, {"num_agents": 2, "command": {"probability": 1.0}})
    torch.manual_seed(0)
    policy = greedy_policy(make_network(scenario, "damped"))
    maneuvers = run_maneuvers(scenario, policy, 6, seed=1)
    found = [measure(one, scenario) for one in maneuvers]
    completed = [row for row in found if row.outcome == Outcome.COMPLETED]
    assert len(completed) >= 4
    for row in completed:
        assert row.return_ <= row.optimal_return < 0.0
        assert row.return_ > 10.0 * row.optimal_return
    assert evaluate(maneuvers, scenario)["cost_ratio"] >= 1.0


def test_the_policy_is_asked_for_steering_agents_alone():
    calls = []

    def act(observations):
        calls.append(observations.shape)
        return np.zeros((len(observations), 1))

    maneuvers = run_maneuvers(ADVERSARIAL, act, 5, seed=0)
    assert all(count > 0 and width == 6 for count, width in calls)
    assert sum(count for count, _ in calls) == sum(len(one.trace) for one in maneuvers)


def test_progress_rises_to_the_number_of_commands():
    counts = []
    run_maneuvers(ADVERSARIAL, slowly, 3, seed=0, progress=counts.append)
    assert counts == sorted(counts)
    assert counts[-1] == 5


@pytest.mark.parametrize("number", [0, -3])
def test_at_least_one_maneuver(number):
    with pytest.raises(ValueError, match=rf"num_maneuvers = {number}: must be at least 1"):
        run_maneuvers("paper", slowly, number)


@pytest.mark.parametrize("overrides", [{"num_agents": None}, {"command": {"probability": 0.0}}])
def test_episodes_without_an_end_are_refused(overrides):
    with pytest.raises(ScenarioError, match=r"scenario 'paper'.*needs num_agents.*probability"):
        run_maneuvers(load_scenario("paper", overrides), slowly, 1)


BOTH = load_scenario(
    ADVERSARIAL,
    {
        "action": {"longitudinal": {}},
        "reward": {"delay_weight": 0.5, "longitudinal_weight": 0.1},
    },
)


def test_two_actions_are_asked_of_those_that_wait_as_well():
    calls = []

    def act(observations):
        calls.append(len(observations))
        return np.hstack([slowly(observations), np.full((len(observations), 1), 0.5)])

    maneuvers = run_maneuvers(BOTH, act, 5, seed=0)
    lives = [round(one.time_to_end / BOTH.time_step) for one in maneuvers]
    steered = [len(one.trace) for one in maneuvers]
    assert sum(calls) == sum(lives) > sum(steered)
    for one, life in zip(maneuvers, lives, strict=True):
        # The trace has only steering steps; delay has a cost in all steps.
        assert set(one.trace["phase"]) <= {Phase.ENGAGED, Phase.ABORTING}
        found = measure(one, BOTH, with_optimum=False)
        assert one.episode_reward <= found.return_ - 0.5 * BOTH.time_step * life + 1e-6
        # Car following would take up to 2 m/s^2.
        assert (one.trace["acceleration"] <= 0.5 + 1e-9).all()
    assert max(one.trace["acceleration"].max() for one in maneuvers if len(one.trace)) > 0.4


def test_followers_may_be_given():
    scenario = load_scenario(ADVERSARIAL, {"followers": {"mix": {"given": 1.0}}})
    seen = []

    def pull(observations):
        seen.append(observations.shape)
        return np.full(len(observations), 2.0)

    maneuvers = run_maneuvers(scenario, slowly, 20, seed=0, follower_policies={"given": pull})
    assert sum(count for count, _ in seen) > 50
    assert {width for _, width in seen} == {9}
    again = run_maneuvers(scenario, slowly, 20, seed=0, follower_policies={"given": pull})
    assert [repr(one) for one in again] == [repr(one) for one in maneuvers]
    with pytest.raises(ScenarioError, match="given"):
        run_maneuvers(scenario, slowly, 1)
