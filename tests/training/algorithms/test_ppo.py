"""PPO: whose steps make an advantage, what the critics see, and that a learner resumes it."""

from functools import partial

import pytest
import torch
from learners import TWO_ACTIONS, baseline, check_resuming, state

from marl_lanes import load_scenario
from marl_lanes.envs.vehicle_table import state_columns
from marl_lanes.training.algorithms.ppo import STATE_SCALES, take_surroundings
from marl_lanes.training.transitions import live_transitions

torch.set_num_threads(1)
pytestmark = pytest.mark.filterwarnings(
    "ignore:Creating .* which inherits from WeightUpdaterBase:DeprecationWarning"
)
GAMMA, LMBDA = 0.9, 0.8
DISCOUNTS = (f"loss.gamma={GAMMA}", f"loss.lmbda={LMBDA}")


@pytest.fixture(params=["ippo", "mappo"])
def collected(request):
    """An algorithm after some updates, and a batch in which agents come, wait and go."""
    learner = baseline(
        request.param, *DISCOUNTS, "collector.steps_per_batch=150", overrides=TWO_ACTIONS
    )
    yield learner.algorithm, learner.collector.next()
    learner.collector.shutdown()


def follow(rows, starts, algorithm):
    """The advantages by their definition, step by step along each slot."""
    value, following = (
        algorithm.critic(one)["state_value"].detach().squeeze(-1) for one in (rows, rows["next"])
    )
    reward, done, terminated = (
        rows["next", key].squeeze(-1) for key in ("reward", "done", "terminated")
    )
    error = reward + GAMMA * following * ~terminated - value
    wanted = torch.zeros_like(error)
    places = {place: index for index, place in enumerate(starts)}
    for (road, time, slot), index in reversed(places.items()):
        wanted[index] = error[index]
        later = places.get((road, time + 1, slot))
        if later is not None and not done[index]:
            wanted[index] += GAMMA * LMBDA * wanted[later]
    return wanted, value


def test_advantages_run_along_each_agents_own_steps(collected):
    """To the end of its attempt: not into the next agent of the slot, nor over a wait."""
    algorithm, batch = collected
    acting = batch["changers", "acting"]
    found = algorithm.take_in(batch)
    rows = live_transitions(batch)
    if algorithm.is_centralised:
        for one, states in ((rows, batch["state"]), (rows["next"], batch["next", "state"])):
            one["state"] = take_surroundings(states, acting)
    places = sorted(map(tuple, acting.nonzero().tolist()), key=lambda at: (at[0], at[1]))
    assert places == list(map(tuple, acting.nonzero().tolist()))
    wanted, value = follow(rows, places, algorithm)
    advantage = found["advantage"].squeeze(-1)
    torch.testing.assert_close(advantage, wanted, rtol=1e-4, atol=1e-4)
    target = found["value_target"].squeeze(-1)
    torch.testing.assert_close(target, wanted + value, rtol=1e-4, atol=1e-4)
    done = rows["next", "done"].squeeze(-1)
    # There are agents that follow another one in its slot, and attempts that the batch cuts.
    assert 10 < done.sum() < len(rows)
    assert acting[:, -1].any()


def test_the_probability_is_that_with_which_the_action_was_drawn(collected):
    algorithm, batch = collected
    found = algorithm.take_in(batch)
    mean = algorithm.network(found["observation"])
    sigma = algorithm.gaussian.log_sigma.exp()
    wanted = torch.distributions.Normal(mean, sigma).log_prob(found["action"]).sum(-1)
    torch.testing.assert_close(found["action_log_prob"], wanted)
    share = (found["action"] - mean) / sigma
    assert share.std(0).tolist() == pytest.approx([1.0, 1.0], rel=0.1)
    # Before an update the ratio is 1: the objective is the mean of the normalised advantages.
    losses = algorithm.take_step(found, 1)
    assert losses["actor_loss"].item() == pytest.approx(0.0, abs=1e-5)
    assert losses["kl"].item() == pytest.approx(0.0, abs=1e-6)


def test_good_actions_become_more_likely_and_the_critic_learns(collected):
    algorithm, batch = collected
    rows = algorithm.take_in(batch)
    rows["advantage"] = torch.where(rows["action"][:, :1] > 0.0, 1.0, -1.0)
    before = algorithm.network(rows["observation"]).mean(0)
    kept = state(algorithm)
    losses = [algorithm.take_step(rows, number) for number in range(1, 21)]
    after = algorithm.network(rows["observation"]).mean(0)
    assert after[0] > before[0]
    assert losses[-1]["loss"] < losses[0]["loss"]
    changed = {key for key, value in state(algorithm).items() if not torch.equal(kept[key], value)}
    for part in ("actor_network_params", "critic_network_params"):
        assert any(key.startswith(part) for key in changed)
    assert any("log_sigma" in key for key in changed)


def test_a_gradient_is_scaled_down_part_by_part(collected):
    algorithm, batch = collected
    optimizer = algorithm.config.optimizer.model_copy(update={"max_gradient_norm": 0.001})
    algorithm.config = algorithm.config.model_copy(update={"optimizer": optimizer})
    algorithm.take_step(algorithm.take_in(batch), 1)
    for part in algorithm.parts:
        norm = torch.stack([one.grad.norm() for one in part]).norm()
        assert norm.item() == pytest.approx(0.001, rel=1e-3)


def test_the_first_distribution_is_as_configured():
    options = ("exploration.initial_sigma=0.2", "exploration.longitudinal_factor=2.0")
    learner = baseline("ippo", *options, overrides=TWO_ACTIONS)
    learner.collector.shutdown()
    algorithm = learner.algorithm
    half_range = algorithm.network.box.half_range
    wanted = torch.tensor([0.2, 0.4]) * half_range
    torch.testing.assert_close(algorithm.gaussian.log_sigma.detach().exp(), wanted)
    assert algorithm.schedules()["sigma"] == pytest.approx(0.2)
    # The box of the second action is not about zero.
    observation = algorithm.network.normalise.offset.expand(5, -1)
    assert algorithm.network(observation)[:, 1].abs().max() < 0.05


def test_the_critic_sees_every_vehicle_from_the_agents_place():
    """Two roads of three vehicles and an empty row; the last agent's vehicle has gone."""
    road = torch.tensor(
        [
            [90.0, 2.0, 21.0, 0.5, 0.01, 0.02, -1.0],
            [80.0, 4.0, 20.0, 1.0, 0.03, 0.06, 1.0],
            [10.0, 6.0, 19.0, 0.0, 0.00, 0.00, 0.0],
            [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -1.0],
        ]
    )
    assert len(STATE_SCALES) == len(state_columns(load_scenario("trucks"))) - 1
    acting = torch.tensor([[True, True, False], [False, False, True]])
    seen = take_surroundings(torch.stack([road, road]), acting).unflatten(-1, (4, 6))
    assert seen.shape == (3, 4, 6)
    scales = torch.tensor(STATE_SCALES[:6])
    first, second, third = seen * scales
    # Slot 0: its own vehicle, then by distance.
    torch.testing.assert_close(first[:, 0], torch.tensor([0.0, 70.0, 80.0, 0.0]))
    torch.testing.assert_close(second[:, 0], torch.tensor([0.0, 10.0, -70.0, 0.0]))
    torch.testing.assert_close(second[:, 1], torch.tensor([0.0, -2.0, 2.0, 0.0]))
    torch.testing.assert_close(second[:, 2], torch.tensor([0.0, 1.0, -1.0, 0.0]))
    torch.testing.assert_close(second[0, 3:], road[1, 3:6])
    assert not third.any()
    # With sizes: as they are, of every vehicle.
    sizes = torch.tensor([[16.5, 2.55], [4.8, 1.8], [4.8, 1.8], [0.0, 0.0]])
    sized = torch.cat([road[:, :-1], sizes, road[:, -1:]], -1)
    wide = take_surroundings(torch.stack([sized, sized]), acting).unflatten(-1, (4, 8))
    assert torch.equal(wide[..., :6], seen)
    assert wide[0, :, 6].tolist() == pytest.approx([0.24, 0.24, 0.825, 0.0])


@pytest.mark.training
@pytest.mark.parametrize("name", ["ippo", "mappo"])
def test_a_training_that_is_resumed_is_the_same(tmp_path, name):
    metrics = check_resuming(tmp_path, partial(baseline, name))
    assert list(metrics[0])[2:6] == ["loss", "actor_loss", "kl", "sigma"]
    assert float(metrics[-1]["loss"]) > 0.0
    updates = [int(row["updates"]) for row in metrics]
    assert updates == sorted(updates)


@pytest.mark.training
def test_a_copy_that_drives_follows_the_actor(tmp_path):
    copy = partial(baseline, "ippo", acting_device=torch.device("cpu", 0))
    for name, make in (("one", partial(baseline, "ippo")), ("copy", copy)):
        learner = make()
        learner.begin(tmp_path / name)
        learner.algorithm.anneal(0)
        for _ in range(2):
            learner.learn(learner.collect())
        learner.close()
    tables = [(tmp_path / name / "metrics.csv").read_bytes() for name in ("one", "copy")]
    assert tables[0] == tables[1]
