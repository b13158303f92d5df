"""The noise on the greedy actions, and the copy of the network that acts."""

import pytest
import torch
from elsewhere import ELSEWHERE, NoHost
from learners import TWO_ACTIONS, Evaluation, changers, followers, tables
from tensordict import TensorDict
from tensordict.nn import TensorDictSequential

from marl_lanes import LaneChangeEnv
from marl_lanes.training.algorithms.exploration import GaussianNoise, NoisyActor
from marl_lanes.training.checkpoint import make_network
from marl_lanes.training.config import ExplorationConfig
from marl_lanes.training.transitions import LivePolicy

torch.set_num_threads(1)
pytestmark = pytest.mark.filterwarnings(
    "ignore:Creating .* which inherits from WeightUpdaterBase:DeprecationWarning"
)


@pytest.mark.training
def test_a_copy_that_drives_follows_the_network(tmp_path):
    """As where the network learns on a GPU and workers drive on the CPU."""
    runs = {}
    for name, places in (("one", {}), ("copy", {"acting_device": torch.device("cpu", 0)})):
        learner = changers(**places)
        assert (learner.algorithm.actor.network is learner.algorithm.network) == (name == "one")
        learner.begin(tmp_path / name)
        assert learner.train(Evaluation())
        learner.close()
        runs[name] = tables(tmp_path / name)
    assert runs["one"] == runs["copy"]
    # That of the last batch's beginning, of which the updates have made another.
    actor, network = (
        learner.algorithm.actor.network.state_dict(),
        learner.algorithm.network.state_dict(),
    )
    assert any(not torch.equal(actor[key], network[key]) for key in network)


@pytest.mark.parametrize("mu", ["cascade", "cascade-gated", "paper", "damped", "mlp", "paper+idm"])
def test_on_another_device_an_agent_needs_nothing_of_the_host(mu):
    """Steps on a GPU would wait for it; as a graph they would fail."""
    env = LaneChangeEnv("interactive" if "+" in mu else "paper", 1, seed=0)
    network = make_network(env.scenario, mu, [8]).to(ELSEWHERE)
    size = network.action_dim
    noise = GaussianNoise(
        ("changers", "action"), network.box, network.box.half_range.clone(), 0.1, 0.5
    )
    drive = LivePolicy(network.policy().module, size, device=ELSEWHERE)
    seen = {
        "observation": torch.zeros(4, 3, len(network.features), device=ELSEWHERE),
        "acting": torch.zeros(4, 3, dtype=torch.bool, device=ELSEWHERE),
    }
    step = TensorDict({"changers": seen}, [4])
    with NoHost():
        found = TensorDictSequential(drive, noise)(step)["changers", "action"]
    assert (found.shape, found.device) == ((4, 3, size), ELSEWHERE)


def sampled_noise(learner, group, num_actions):
    """Many actions after the noise, all zero before it."""
    action = torch.zeros(8, 4, num_actions)
    steps = [TensorDict({group: {"action": action.clone()}}, [8]) for _ in range(400)]
    noise = learner.algorithm.actor.noise
    return torch.stack([noise(step)[group, "action"] for step in steps])


@pytest.mark.training
@pytest.mark.parametrize(("sigma", "factor"), [(0.02, 1.0), (0.1, 1.0), (0.02, 4.0)])
def test_the_noise_is_a_share_of_each_half_range(sigma, factor):
    options = (
        f"exploration.initial_sigma={sigma}",
        "exploration.final_sigma=0.01",
        f"exploration.longitudinal_factor={factor}",
        "exploration.probability=1.0",
    )
    learner = changers(*options, overrides=TWO_ACTIONS, mu="mlp")
    noise = sampled_noise(learner, "changers", 2)
    # Bounds -0.5 to 0.5 and -5 to 1: half ranges 0.5 and 3.
    assert noise[..., 0].std().item() == pytest.approx(sigma * 0.5, rel=0.03)
    assert noise[..., 1].std().item() == pytest.approx(factor * sigma * 3.0, rel=0.03)
    assert noise.mean((0, 1, 2)).abs().max() < factor * sigma * 0.1
    learner.collector.shutdown()
    learner = followers(*options)
    noise = sampled_noise(learner, "followers", 1)
    assert noise.std().item() == pytest.approx(sigma * 3.0, rel=0.03)
    learner.collector.shutdown()


def noisy_actor(acting_device="cpu", probability=1.0):
    settings = ExplorationConfig(
        initial_sigma=0.4,
        final_sigma=0.1,
        annealing_transitions=200,
        probability=probability,
        longitudinal_factor=1.0,
    )
    env = LaneChangeEnv("paper", 1, seed=0)
    network = make_network(env.scenario, "damped", [8])
    devices = torch.device("cpu"), torch.device(acting_device)
    return NoisyActor(settings, env, network, "changers", *devices), network


def test_the_noise_falls_linearly_to_its_final_size():
    actor, _ = noisy_actor()
    found = []
    for transitions in (0, 50, 100, 200, 1000):
        actor.anneal(transitions)
        found.append(actor.sigma)
    assert found == pytest.approx([0.4, 0.325, 0.25, 0.1, 0.1])


def test_of_the_actions_a_share_is_noisy():
    actor, network = noisy_actor(probability=0.2)
    shape = (1, 4)
    drive, found = network.policy().module, []
    for _ in range(500):
        observation = torch.zeros(*shape, len(network.features))
        agents = {"observation": observation, "acting": torch.ones(shape) > 0.0}
        driven = actor.policy(TensorDict({"changers": agents}, shape[:1]))["changers", "action"]
        found.append((driven != drive(observation)).flatten())
    noisy = torch.stack(found).float()
    assert noisy.mean().item() == pytest.approx(0.2, abs=0.02)
    # Each agent has its own, in any step.
    assert 0.0 < noisy.mean(0).min() < noisy.mean(0).max() < 0.4


@pytest.mark.parametrize("acting_device", ["cpu", "cpu:0"])
def test_it_acts_with_the_weights_of_its_last_refresh(acting_device):
    actor, network = noisy_actor(acting_device)
    is_copy = acting_device != "cpu"
    assert (actor.network is network) != is_copy
    before = [parameter.clone() for parameter in network.parameters()]
    with torch.no_grad():
        for parameter in network.parameters():
            parameter.add_(1.0)
    kept = zip(actor.network.parameters(), before, strict=True)
    assert all(torch.equal(acting, old) == is_copy for acting, old in kept)
    actor.refresh()
    both = zip(actor.network.parameters(), network.parameters(), strict=True)
    assert all(torch.equal(acting, learned) for acting, learned in both)
