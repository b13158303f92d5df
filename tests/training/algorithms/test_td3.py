"""TD3: its target, its delays and bounds, and that a learner trains, saves and resumes it."""

from functools import partial

import pytest
import torch
from collecting import BUSY
from learners import (
    TWO_ACTIONS,
    Evaluation,
    baseline,
    check_resuming,
    is_changed,
    state,
    tables,
    transitions,
)

from marl_lanes import load_scenario
from marl_lanes.naf.checkpoint import CheckpointError, greedy_policy
from marl_lanes.training.checkpoint import (
    load_checkpoint,
    load_policy,
    save_checkpoint,
)

torch.set_num_threads(1)
pytestmark = pytest.mark.filterwarnings(
    "ignore:Creating .* which inherits from WeightUpdaterBase:DeprecationWarning"
)

make = partial(baseline, "td3")


@pytest.fixture
def learner(request):
    """With two actions, of different ranges, one not about zero."""
    made = make(*getattr(request, "param", ()), overrides=TWO_ACTIONS)
    yield made
    made.collector.shutdown()


@pytest.mark.parametrize("learner", [["loss.target_noise=0.0", "loss.gamma=0.9"]], indirect=True)
def test_the_loss_is_that_of_the_source(learner):
    """What ends without a successor has the reward alone; what is cut off keeps its value."""
    algorithm = learner.algorithm
    torch.manual_seed(5)
    for _ in range(3):
        algorithm.take_step(transitions(algorithm), 2)
    batch = transitions(algorithm)
    loss = algorithm.loss

    def values(params, observation, action):
        found = []
        for critic in range(2):
            with params[critic].to_module(loss.qvalue_network):
                found.append(loss.qvalue_network.module(observation, action))
        return torch.stack(found)

    following = batch["next"]
    with torch.no_grad():
        with loss.target_actor_network_params.to_module(loss.actor_network):
            action = loss.actor_network.module(following["observation"])
        lowest = values(loss.target_qvalue_network_params, following["observation"], action).amin(0)
        target = following["reward"] + 0.9 * ~following["terminated"] * lowest
        found = values(loss.qvalue_network_params, batch["observation"], batch["action"])
    wanted = (found - target).square().sum(0).mean()
    assert algorithm.take_step(batch, 1)["loss"].item() == pytest.approx(wanted.item(), rel=1e-5)
    assert following["truncated"].any()
    assert following["terminated"].any()


@pytest.mark.parametrize(
    "learner", [["loss.target_noise=0.2", "loss.target_noise_bound=0.5"]], indirect=True
)
def test_the_targets_noise_is_a_share_of_each_half_range_and_stays_in_the_box(learner, monkeypatch):
    algorithm = learner.algorithm
    box = algorithm.network.box
    seen = []
    network = algorithm.loss.qvalue_network
    forward = type(network.module).forward

    def watch(self, observation, action):
        seen.append(action)
        return forward(self, observation, action)

    monkeypatch.setattr(type(network.module), "forward", watch)
    batch = transitions(algorithm, 4000)
    # The targets are still what they were copied from.
    with torch.no_grad():
        plain = algorithm.network(batch["next", "observation"])
    # One critic after the other, for plain tensors to look at.
    algorithm.loss.deactivate_vmap = True
    algorithm.loss._make_vmap()
    algorithm.loss.value_loss(batch)
    noisy = next(one for one in seen if not torch.equal(one, batch["action"]))
    noise = (noisy - plain) / box.half_range
    assert noise.abs().max() <= 0.5 + 1e-6
    assert noise.std(0).tolist() == pytest.approx([0.2, 0.2], rel=0.1)
    assert ((noisy >= box.low) & (noisy <= box.high)).all()


def test_actor_and_targets_are_updated_every_other_time(learner):
    algorithm = learner.algorithm
    start = state(algorithm)
    losses = algorithm.take_step(transitions(algorithm), 1)
    first = state(algorithm)
    assert set(losses) == {"loss"}
    changed = {part: is_changed(start, first, part) for part in PARTS}
    assert changed == dict.fromkeys(PARTS, False) | {"qvalue": True}
    losses = algorithm.take_step(transitions(algorithm), 2)
    second = state(algorithm)
    assert set(losses) == {"loss", "actor_loss"}
    assert all(is_changed(first, second, part) for part in PARTS)
    tau = learner.config.loss.tau
    for key, value in second.items():
        if key.startswith("target_") and "layers" in key:
            source = second[key.removeprefix("target_")]
            assert torch.allclose(value, first[key] + tau * (source - first[key]), atol=1e-7), key


PARTS = ("qvalue", "actor", "target_qvalue", "target_actor")


def test_the_actor_climbs_the_first_critic(learner):
    algorithm = learner.algorithm
    batch = transitions(algorithm)
    before = algorithm.take_step(batch, 2)["actor_loss"].item()
    rates = [group["lr"] for group in algorithm.optimizer.param_groups]
    # The critics stand still.
    algorithm.optimizer.param_groups[0]["lr"] = 0.0
    for _ in range(20):
        after = algorithm.take_step(batch, 2)["actor_loss"].item()
    assert after < before
    assert rates == list(algorithm.rates)


@pytest.mark.parametrize("learner", [["optimizer.final_rate=0.5"]], indirect=True)
def test_step_sizes_and_noise_fall(learner):
    algorithm = learner.algorithm
    for count, share in ((0, 1.0), (150, 0.75), (300, 0.5), (900, 0.5)):
        algorithm.anneal(count)
        found = [group["lr"] for group in algorithm.optimizer.param_groups]
        assert found == pytest.approx([rate * share for rate in algorithm.rates])
    assert algorithm.schedules()["sigma"] == pytest.approx(algorithm.config.exploration.final_sigma)


@pytest.mark.training
@pytest.mark.parametrize("overrides", [BUSY, TWO_ACTIONS], ids=["one", "two"])
def test_a_training_that_is_resumed_is_the_same(tmp_path, overrides):
    metrics = check_resuming(tmp_path, partial(make, overrides=overrides))
    assert list(metrics[0])[2:5] == ["loss", "actor_loss", "sigma"]
    assert float(metrics[-1]["loss"]) > 0.0


@pytest.mark.training
def test_a_copy_that_drives_follows_the_actor(tmp_path):
    found = {}
    for name, places in (("one", {}), ("copy", {"acting_device": torch.device("cpu", 0)})):
        learner = make(**places)
        learner.begin(tmp_path / name)
        assert learner.train(Evaluation())
        learner.close()
        found[name] = tables(tmp_path / name)
    assert found["one"] == found["copy"]


def test_its_checkpoint_drives_where_it_fits(tmp_path, learner):
    network, scenario = learner.algorithm.network, learner.env.scenario
    path = tmp_path / "actor.pt"
    save_checkpoint(path, network, "paper", 7)
    found = load_policy(path, scenario)
    assert (found.scenario, found.transitions) == ("paper", 7)
    observations = transitions(learner.algorithm)["observation"].numpy()
    actions = greedy_policy(found.network)(observations)
    assert actions.shape == (64, 2)
    assert (actions == greedy_policy(network)(observations)).all()
    with pytest.raises(CheckpointError, match=r"actor\.pt: its action bounds .* changers of"):
        load_policy(path, load_scenario("paper"))
    # What goes on with NAF needs a network of NAF.
    with pytest.raises(CheckpointError, match=r"actor\.pt: not a checkpoint of the form '.* NAF"):
        load_checkpoint(path, scenario)
    torch.save({"format": "another"}, path)
    with pytest.raises(CheckpointError, match=r"actor\.pt: not a checkpoint of the forms '.* NAF"):
        load_policy(path, scenario)
