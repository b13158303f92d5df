"""NAF's updates: step sizes, the two stages, the compiled loss."""

from functools import partial
from types import SimpleNamespace

import pytest
import torch
from collecting import BUSY
from learners import Evaluation, changers, check_resuming, filled, tiny, weights_of
from tensordict import TensorDict
from torch._dynamo.utils import counters

from marl_lanes import LaneChangeEnv, load_scenario
from marl_lanes.naf import NAFLoss
from marl_lanes.naf.batched_loss import BatchedNAFLoss
from marl_lanes.training import graphs
from marl_lanes.training.algorithms import naf
from marl_lanes.training.algorithms.naf import NAF
from marl_lanes.training.checkpoint import make_network

META = torch.device("meta")
torch.set_num_threads(1)
pytestmark = [
    pytest.mark.training,
    pytest.mark.filterwarnings(
        "ignore:Creating .* which inherits from WeightUpdaterBase:DeprecationWarning"
    ),
]


@pytest.mark.parametrize("option", ["mu_learning_rate=0.0001", "mu_learning_rate=0.001"])
def test_each_network_learns_at_its_rate(tmp_path, option):
    learner = filled(tmp_path, f"optimizer.{option}", "optimizer.max_gradient_norm=null")
    before = weights_of(learner)
    learner.update(1)
    learner.close()
    after = weights_of(learner)
    # Adam's first step is the rate, whatever the gradient.
    for part, rate in (("value", 1e-3), ("factor_logits", 1e-3), ("mu", float(option[17:]))):
        keys = [key for key in before if key.startswith(f"value_network_params.{part}")]
        steps = [(after[key] - before[key]).abs().max().item() for key in keys]
        assert max(steps) == pytest.approx(rate, rel=1e-2), part


def test_the_frozen_mu_of_stage_one_begins_as_new_in_stage_two(tmp_path):
    options = ["optimizer.mu_learning_rate=0.0002", "optimizer.max_gradient_norm=null"]
    learner = filled(tmp_path, *options, "optimizer.pretraining_transitions=1000")

    def update(transitions):
        learner.counters["transitions"] = transitions
        learner.algorithm.anneal(transitions)
        before = weights_of(learner)
        learner.update(5 if transitions < 1000 else 1)
        after = weights_of(learner)
        return {
            part: max(
                (after[key] - before[key]).abs().max().item()
                for key in before
                if key.startswith(f"value_network_params.{part}")
            )
            for part in ("value", "mu")
        }

    first, second = update(0), update(1000)
    learner.close()
    assert first["value"] > 0.0
    assert first["mu"] == 0.0
    # Adam's first step is the rate, its later ones after zero gradients would be larger.
    assert second["mu"] == pytest.approx(2e-4, rel=1e-2)


def test_an_encoder_learns_with_v_in_both_stages():
    overrides = BUSY | {"observation": {"num_stacked": 2}}
    env = LaneChangeEnv("paper", 1, overrides=overrides, seed=0)
    torch.manual_seed(0)
    network = make_network(env.scenario, "cascade", [8], encoder="gru")
    algorithm = NAF(tiny("optimizer.pretraining_transitions=100"), env, network)
    rows = TensorDict({"observation": torch.randn(16, 12), "action": torch.zeros(16, 1)}, [16])
    ends = torch.zeros(16, 1, dtype=torch.bool)
    rows["next"] = TensorDict(
        {"observation": torch.randn(16, 12), "reward": torch.ones(16, 1)}, [16]
    )
    rows["next"].update({"done": ends, "terminated": ends})
    for transitions in (0, 200):
        algorithm.anneal(transitions)
        before = [weight.clone() for weight in network.encoder.parameters()]
        algorithm.take_step(rows, 1)
        after = network.encoder.parameters()
        assert len(before) == 4
        assert not any(torch.equal(*pair) for pair in zip(before, after, strict=True))


def test_step_sizes_fall_through_stage_two(tmp_path):
    learner = filled(
        tmp_path,
        "optimizer.learning_rate=0.001",
        "optimizer.mu_learning_rate=0.0002",
        "optimizer.final_rate=0.1",
        "optimizer.pretraining_transitions=1000",
        "collector.total_transitions=3000",
    )
    for transitions, share in ((0, 1.0), (1000, 1.0), (2000, 0.55), (3000, 0.1), (3500, 0.1)):
        learner.counters["transitions"] = transitions
        learner.algorithm.anneal(transitions)
        rates = [group["lr"] for group in learner.algorithm.optimizer.param_groups]
        assert rates == pytest.approx([0.001 * share, 0.0002 * share])
    learner.close()


@pytest.mark.parametrize("is_batched", [False, True])
def test_graphed_updates_are_the_same_updates(tmp_path, monkeypatch, is_batched):
    """In both stages; a replay calls the function here."""
    monkeypatch.setattr(graphs, "capture", lambda function: function)
    options = ("optimizer.final_rate=0.1", "loss.target_interval=3")
    found = []
    for is_graphed in (False, True):
        learner = filled(tmp_path / str(is_graphed), *options, is_batched=is_batched)
        algorithm = learner.algorithm
        algorithm.is_graphed = is_graphed
        # As precise as the numbers that they are otherwise.
        algorithm.step_sizes = [place.double() for place in algorithm.step_sizes]
        torch.manual_seed(9)
        losses = []
        for transitions in (0, 200, 250):
            algorithm.anneal(transitions)
            losses += learner.update(8)["loss"].tolist()
        learner.close()
        assert len(algorithm.graphs) == 4 * is_graphed
        found.append((losses, weights_of(learner)))
    (losses, weights), (others, other_weights) = found
    assert losses == others
    assert len(set(losses)) == 24
    assert all(torch.equal(other_weights[key], value) for key, value in weights.items())


@pytest.mark.parametrize(
    "options",
    [
        ["loss.target_interval=3"],
        ["loss.target_update=hard", "loss.num_steps=2", "optimizer.max_gradient_norm=null"],
    ],
)
@pytest.mark.parametrize("mu", ["damped", "cascade-gated"])
def test_batched_updates_are_the_same_updates_to_rounding(tmp_path, mu, options):
    """In both stages."""
    found = []
    for is_batched in (False, True):
        learner = filled(tmp_path / str(is_batched), *options, mu=mu, is_batched=is_batched)
        torch.manual_seed(9)
        losses = []
        for transitions in (0, 200):
            learner.algorithm.anneal(transitions)
            losses += learner.update(8)["loss"].tolist()
        learner.close()
        found.append((losses, weights_of(learner), learner.algorithm))
    (losses, weights, plain), (others, other_weights, batched) = found
    assert others == pytest.approx(losses, rel=1e-4)
    assert len(set(others)) == 16
    # What a training state has of them, which any device can go on from.
    assert other_weights.keys() == weights.keys()
    for key, value in weights.items():
        torch.testing.assert_close(other_weights[key], value, rtol=1e-3, atol=1e-4)
    states = [one.optimizer.state_dict() for one in (plain, batched)]
    assert states[0]["param_groups"] == states[1]["param_groups"]
    for index, state in states[0]["state"].items():
        for name, value in state.items():
            assert states[1]["state"][index][name].shape == value.shape
        assert states[1]["state"][index]["step"] == state["step"]


def test_a_batched_training_goes_on_as_a_plain_one_and_back(tmp_path):
    for number, is_batched in enumerate([False, True, False], 1):
        options = ["replay.capacity=150", f"collector.total_transitions={150 * number}"]
        learner = changers(*options, is_batched=is_batched)
        if number == 1:
            learner.begin(tmp_path)
        else:
            learner.resume(tmp_path)
            assert learner.transitions >= 150 * (number - 1)
        assert learner.train(Evaluation())
        learner.close()


def test_a_batched_training_goes_on_as_if_it_had_not_stopped(tmp_path):
    check_resuming(tmp_path, partial(changers, is_batched=True))


def test_networks_are_evaluated_together_on_a_gpu_alone():
    env = LaneChangeEnv("paper", 1, overrides=BUSY, seed=0)
    network = make_network(env.scenario, "cascade", [8])
    assert type(NAF(tiny(), env, network).loss) is NAFLoss
    assert type(NAF(tiny(), env, network, is_batched=True).loss) is BatchedNAFLoss


def test_all_its_tensors_are_on_its_device(monkeypatch):
    """The meta device, which does not mix with others."""
    # It asks whether tensors share memory, and there is none.
    monkeypatch.setattr(naf, "ForeachSoftUpdate", lambda *_, **__: None)
    network = make_network(load_scenario("paper"), "cascade", [8])
    roads = SimpleNamespace(device=META)
    algorithm = NAF(tiny(), roads, network, device=META, acting_device=META)
    algorithm.anneal(200)
    tensors = [
        *algorithm.loss.state_dict().values(),
        *algorithm.policy.state_dict().values(),
        *(one for group in algorithm.optimizer.param_groups for one in group["params"]),
        *algorithm.gradients,
        *algorithm.step_sizes,
    ]
    assert {one.device for one in tensors} == {META}


@pytest.mark.filterwarnings("ignore:`torch.jit.script_method` is deprecated:DeprecationWarning")
# Inside torch, when it compiles a function with a derivative of its own.
@pytest.mark.filterwarnings("ignore:.*should not be instantiated:DeprecationWarning")
@pytest.mark.long
@pytest.mark.parametrize("is_batched", [False, True])
def test_a_compiled_loss_gives_the_same_losses(tmp_path, is_batched):
    results = []
    for option in ("false", "true"):
        learner = filled(tmp_path / option, f"optimizer.compile={option}", is_batched=is_batched)
        torch.manual_seed(9)
        results.append(learner.update(5)["loss"].tolist())
        learner.close()
    # Adam divides by the gradient's size: the rounding of a tiny one is a whole step.
    assert results[0] == pytest.approx(results[1], rel=1e-3)


@pytest.mark.filterwarnings("ignore:`torch.jit.script_method` is deprecated:DeprecationWarning")
@pytest.mark.filterwarnings("ignore:.*should not be instantiated:DeprecationWarning")
@pytest.mark.long
def test_a_loss_is_compiled_whole_and_before_its_capture(tmp_path, monkeypatch):
    """Once in each stage: a capture would fail if torch compiled within it."""
    torch.compiler.reset()
    counters.clear()
    numbers = []

    def capture(function):
        numbers.append(counters["stats"]["unique_graphs"])
        return function

    monkeypatch.setattr(graphs, "capture", capture)
    options = ("optimizer.compile=true", "loss.target_interval=3")
    learner = filled(tmp_path, *options, is_batched=True)
    learner.algorithm.is_graphed = True
    for transitions in (0, 200):
        learner.algorithm.anneal(transitions)
        learner.update(20)
    learner.close()
    assert numbers == [1, 1, 2, 2]
    assert counters["stats"]["unique_graphs"] == 2
    assert not counters["graph_break"]
