"""NAFNetwork: the quadratic form, its maximum over the box, its policy and its arguments."""

import doctest
import itertools
import math
from collections.abc import Iterable

import pytest
import torch
from naf.paper_networks import PAPER, call, make_network, make_observation, state, stir
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch import nn
from torchrl.data import Bounded, Composite, Unbounded
from torchrl.envs import EnvBase

import marl_lanes.naf.network
from marl_lanes.naf import NAFNetwork
from marl_lanes.naf.mu import LATERAL

EXTREMES = (1e30, 4.0, 0.0, -4.0, -1e30)


@pytest.mark.parametrize("actions", [1, 2, 3])
def test_forward_is_the_quadratic_form(actions):
    network = stir(make_network(actions=actions, bound=0.5))
    observation = make_observation(7, 5)
    action = torch.rand(7, 5, actions) - 0.5
    data = call(network, observation, action)
    mu, value, q = (data[key] for key in network.out_keys)
    assert (mu.shape, value.shape, q.shape) == ((7, 5, actions), (7, 5, 1), (7, 5, 1))
    assert (mu.abs() <= 0.5).all()
    factor = network.cholesky(observation)
    distance = ((mu - action) / 0.5).unsqueeze(-1)
    expected = (distance.mT @ -(factor @ factor.mT) @ distance).squeeze(-1) + value
    torch.testing.assert_close(q, expected)
    torch.testing.assert_close(network.max_value(observation), value)
    only_state = call(network, observation)
    assert "state_action_value" not in only_state.keys()  # noqa: SIM118
    torch.testing.assert_close(only_state["state_value"], value)


@pytest.mark.parametrize("actions", [1, 2, 3])
def test_m_is_negative_definite_at_extreme_logits(actions):
    network = make_network(actions=actions)
    entries = actions * (actions + 1) // 2
    choices = EXTREMES if actions < 3 else (1e30, 0.0, -1e30)
    logits = torch.tensor(list(itertools.product(choices, repeat=entries)))
    network.factor_logits = nn.Identity()
    logits.requires_grad_()
    factor = network._factor(logits)
    square = factor.unsqueeze(-1) if actions == 1 else factor
    matrix = -(square @ square.mT)
    assert matrix.dtype is torch.float32
    assert torch.linalg.eigvalsh(matrix.detach()).max() < 0
    mu, action = (
        torch.full((2, len(logits), actions), 0.5) * torch.tensor([1.0, -1.0])[:, None, None]
    )
    penalty = network._penalty(factor, mu, mu.sign(), action)
    assert penalty.isfinite().all()
    assert (penalty >= 0).all()
    penalty.sum().backward()
    assert logits.grad.isfinite().all()


@pytest.mark.parametrize("mu", ["cascade", "paper", "damped", "mlp"])
@pytest.mark.parametrize("extreme", [1e30, -1e30])
def test_gradients_are_finite_at_extreme_logits(mu, extreme):
    network = make_network(mu)
    with torch.no_grad():
        for name, parameter in network.named_parameters():
            if name.endswith("4.bias") and not name.startswith("value"):
                parameter.fill_(extreme)
    observation = torch.cat([make_observation(20), state().expand(1, -1)])
    data = call(network, observation, torch.rand(21, 1) - 0.5)
    (data["state_action_value"].sum() + data["greedy_action"].sum()).backward()
    assert data["state_action_value"].isfinite().all()
    assert all(parameter.grad.isfinite().all() for parameter in network.parameters())


def test_m_couples_two_actions():
    network = stir(make_network(actions=2))
    factor = network.cholesky(make_observation(10))
    matrix = -(factor @ factor.mT)
    assert (factor[..., 0, 1] == 0).all()
    assert (matrix[..., 0, 1].abs() > 1e-3).all()
    torch.testing.assert_close(matrix, matrix.mT)


@pytest.mark.parametrize("mu", [-2.0, -0.5, 0.2, 0.5, 3.0])
def test_maximum_over_the_box_is_at_the_clipped_mu(mu):
    class Replaced(nn.Module):
        def forward(self, observation, normalised):  # noqa: ARG002
            return torch.full_like(observation[..., :1], mu)

    network = stir(make_network())
    network.mu = Replaced()
    observation = make_observation(6)
    grid = torch.linspace(-0.5, 0.5, 1001)
    q = call(network, observation.expand(1001, 6, -1), grid.view(-1, 1, 1).expand(-1, 6, 1))
    best, where = q["state_action_value"].max(0)
    data = call(network, observation)
    torch.testing.assert_close(data["state_value"], best)
    torch.testing.assert_close(network.max_value(observation), best)
    torch.testing.assert_close(data["greedy_action"], grid[where])
    assert (data["greedy_action"] == min(max(mu, -0.5), 0.5)).all()


def test_maximum_over_a_box_of_two_actions():
    network = stir(make_network(actions=2))
    observation = make_observation(4)
    line = torch.linspace(-0.5, 0.5, 201)
    grid = torch.cartesian_prod(line, line)
    q = call(
        network,
        observation.expand(len(grid), 4, -1),
        grid.unsqueeze(1).expand(-1, 4, 2),
    )["state_action_value"]
    data = call(network, observation)
    assert (q <= data["state_value"] + 1e-6).all()
    best = grid[q.argmax(0).squeeze(-1)]
    assert (best - data["greedy_action"]).abs().max() < 0.05
    at_greedy = call(network, observation, data["greedy_action"].detach())
    torch.testing.assert_close(at_greedy["state_action_value"], data["state_value"])


@pytest.mark.parametrize("mu", ["cascade", "cascade-smooth", "cascade-gated", "damped", "mlp"])
def test_the_known_cost_of_an_action_bends_q_and_leaves_its_maximum(mu):
    """Q = V - m (a - mu)^2 - c (|a| - |mu| - g (a - mu)), g a slope of |a| at mu."""
    plain, knowing = stir(make_network(mu)), make_network(mu, action_costs=[2.0])
    knowing.load_state_dict(plain.state_dict())
    observation = make_observation(40)
    if mu.startswith("cascade"):  # near the centre and straight: within cascade's threshold
        observation[:20, 2:5] *= 0.01
        observation[:20, 5] = 0.0
    action = torch.linspace(-0.5, 0.5, 101)[:, None, None].expand(101, 40, 1)
    seen = observation.expand(101, 40, -1)
    without, found = call(plain, seen, action), call(knowing, seen, action)
    for key in ("greedy_action", "state_value"):
        assert torch.equal(without[key], found[key]), key
    greedy = found["greedy_action"]
    _, slope = knowing.mu.act(observation, knowing.normalise(observation))
    bend = 2.0 * (action.abs() - greedy.abs() - slope * (action - greedy))
    q = without["state_action_value"] - bend
    torch.testing.assert_close(found["state_action_value"], q, atol=1e-5, rtol=1e-5)
    assert (found["state_action_value"] <= found["state_value"] + 1e-6).all()
    at_greedy = call(knowing, observation, greedy[0].detach())
    torch.testing.assert_close(at_greedy["state_action_value"], at_greedy["state_value"])
    is_zero = greedy[0] == 0.0
    assert is_zero.any() == (mu in {"cascade", "cascade-gated"})
    assert (slope.abs() <= 1.0).all()
    assert torch.equal(slope[~is_zero], greedy[0][~is_zero].sign())
    assert knowing.config["action_costs"] == [2.0]


def test_within_the_threshold_the_slope_still_learns():
    """If mu is exactly 0, the plain parabola gives its structure no gradient."""
    observation = state(lateral_deviation=0.02)[None]
    gradients = {}
    for name, costs in (("plain", None), ("knowing", [2.0])):
        torch.manual_seed(0)
        network = make_network("cascade", action_costs=costs)
        data = call(network, observation, torch.full((1, 1), 0.1))
        assert data["greedy_action"].item() == 0.0
        data["state_action_value"].sum().backward()
        gradients[name] = network.mu.heads.last_bias.grad.abs().sum().item()
    assert gradients["plain"] == 0.0
    assert gradients["knowing"] > 0.01


@pytest.mark.parametrize("costs", [[1.0, 1.0], [-1.0], [math.inf], [math.nan], []])
def test_costs_that_cannot_be_are_refused(costs):
    with pytest.raises(ValueError, match=r"action_costs = .*: must be 1 finite numbers"):
        make_network("cascade", action_costs=costs)


def test_m_is_in_units_of_the_box():
    wide, narrow = make_network(bound=2.0), make_network(bound=0.5)
    narrow.load_state_dict(
        {k: v for k, v in wide.state_dict().items() if "box" not in k}, strict=False
    )
    observation = make_observation(5)
    for share in (-1.0, -0.3, 0.8):
        q = [
            call(network, observation, torch.full((5, 1), share * bound))["state_action_value"]
            for network, bound in ((wide, 2.0), (narrow, 0.5))
        ]
        torch.testing.assert_close(q[0], q[1])


def test_initial_values():
    observation = make_observation(50)
    network = make_network(actions=2)
    factor = network.cholesky(observation)
    diagonal = factor.diagonal(dim1=-2, dim2=-1)
    torch.testing.assert_close(diagonal.square(), torch.full((50, 2), math.e), rtol=0.05, atol=0)
    assert factor[..., 1, 0].abs().max() < 0.05
    assert call(network, observation)["state_value"].abs().max() < 0.05
    assert call(network, observation)["greedy_action"].abs().max() < 0.05


def test_policy_shares_mu_and_evaluates_nothing_else():
    network = stir(make_network("damped"))
    policy = network.policy(("changers", "observation"), ("changers", "action"))
    assert isinstance(policy, TensorDictModule)
    assert {id(p) for p in policy.parameters()} == {id(p) for p in network.mu.parameters()}
    observation = make_observation(3, 4)
    data = TensorDict({"changers": {"observation": observation}}, [3])
    expected = call(network, observation)["greedy_action"]
    network.factor_logits = network.value = None  # calling either would raise
    torch.testing.assert_close(policy(data)["changers", "action"], expected)
    with torch.no_grad():
        network.mu.heads.last_bias.fill_(-1e30)  # poles of 1 rad/s, a_max as low as it goes
    least = 0.03 + 0.01 * 0.5
    is_before = observation[..., PAPER.index("lateral_deviation")] >= 0
    assert policy(data)["changers", "action"][is_before].abs().max() <= least * 1.001
    assert policy(data)["changers", "action"].abs().max() > 0.4


class Roads(EnvBase):
    """Two roads with three agents each; the observations are random."""

    def __init__(self):
        super().__init__(batch_size=[2])
        observation = Composite(observation=Unbounded((2, 3, len(PAPER))), shape=(2, 3))
        action = Composite(action=Bounded(-0.5, 0.5, (2, 3, 1)), shape=(2, 3))
        self.observation_spec = Composite(changers=observation, shape=(2,))
        self.full_action_spec = Composite(changers=action, shape=(2,))
        self.reward_spec = Unbounded((2, 1))

    def _observe(self):
        changers = TensorDict({"observation": make_observation(2, 3)}, [2, 3])
        return TensorDict({"changers": changers}, [2])

    def _reset(self, tensordict=None, **kwargs):  # noqa: ARG002
        return self._observe()

    def _step(self, tensordict):
        reward = tensordict["changers", "action"].sum((-2, -1)).unsqueeze(-1)
        over = torch.zeros(2, 1, dtype=torch.bool)
        return self._observe().update({"reward": reward, "done": over, "terminated": over.clone()})

    def _set_seed(self, seed):
        torch.manual_seed(seed)


# TorchRL warns about its own classes while its collectors are imported.
@pytest.mark.filterwarnings("ignore:Creating .* inherits from WeightUpdaterBase:DeprecationWarning")
def test_policy_in_a_collector():
    from torchrl.collectors import Collector

    network = stir(make_network("paper"))
    policy = network.policy(("changers", "observation"), ("changers", "action"))
    frames = {"frames_per_batch": 8, "total_frames": 8}
    collector = Collector(Roads(), policy, auto_register_policy_transforms=False, **frames)
    (batch,) = iter(collector)
    collector.shutdown()
    expected = call(network, batch["changers", "observation"])["greedy_action"]
    torch.testing.assert_close(batch["changers", "action"], expected.detach())


def test_mu_frozen_stops_only_mus_gradients():
    network = make_network("paper")
    network.mu_frozen = True
    call(network, make_observation(5), torch.zeros(5, 1))["state_action_value"].sum().backward()
    with_gradient = {name for name, p in network.named_parameters() if p.grad is not None}
    assert with_gradient == {
        name for name, _ in network.named_parameters() if not name.startswith("mu.")
    }
    assert with_gradient


def is_plain(value):
    if isinstance(value, dict):
        return all(is_plain(item) for item in itertools.chain(value, value.values()))
    if isinstance(value, Iterable) and not isinstance(value, str):
        return type(value) in (list, tuple) and all(map(is_plain, value))
    return type(value) in (str, int, float, bool, type(None))


@pytest.mark.parametrize("mu", ["cascade", "paper", "damped", "mlp"])
def test_config_round_trip(mu, tmp_path):
    network = stir(make_network(mu, observation_key=("changers", "observation"), bound=0.3))
    assert is_plain(network.config)
    path = tmp_path / "checkpoint.pt"
    torch.save({"config": network.config, "state": network.state_dict()}, path)
    saved = torch.load(path, weights_only=True)
    rebuilt = NAFNetwork(**saved["config"])
    rebuilt.load_state_dict(saved["state"])
    assert rebuilt.config == network.config
    data = TensorDict({"changers": {"observation": make_observation(4)}}, [4])
    data["action"] = torch.rand(4, 1) - 0.5
    first, second = network(data.clone()), rebuilt(data.clone())
    for key in network.out_keys:
        torch.testing.assert_close(first[key], second[key], rtol=0, atol=0)


@pytest.mark.parametrize("name", LATERAL)
def test_a_missing_column_is_named(name):
    for feature in LATERAL[name].needs:
        features = [other for other in PAPER if other != feature]
        with pytest.raises(ValueError, match=f"'{name}' needs the feature '{feature}'"):
            NAFNetwork(features, [-0.5], [0.5], mu=name)


@pytest.mark.parametrize(
    ("kwargs", "message"),
    [
        (
            {"mu": "linear"},
            "unknown mu 'linear', allowed: cascade, cascade-smooth, cascade-gated, paper, .*mlp",
        ),
        (
            {"mu": "paper", "actions": 2},
            "'paper' gives one action.*box has 2; allowed: cascade.idm, .*mlp",
        ),
        ({"mu": "damped", "actions": 3}, "'damped' gives one action.*box has 3; allowed: mlp"),
        ({"bound": -1.0}, "action_low < action_high"),
        ({"bound": math.inf}, "finite"),
        ({"actions": 0}, "one length"),
        ({"scales": [1.0]}, "need 6 offsets and scales"),
        ({"offsets": [1.0] * 7}, "need 6 offsets and scales"),
        ({"scales": [0.0] * 6}, "positive scales"),
    ],
)
def test_constructor_errors(kwargs, message):
    with pytest.raises(ValueError, match=message):
        make_network(**kwargs)


def test_more_errors():
    with pytest.raises(ValueError, match="zero inside"):
        NAFNetwork(PAPER, [0.1], [0.5], mu="paper")
    with pytest.raises(ValueError, match="different names"):
        NAFNetwork(["x", "x"], [-1.0], [1.0], mu="mlp")
    assert NAFNetwork(PAPER, [-1.0], [1.0]).config["hidden_sizes"] == [64, 64]
    network = make_network()
    with pytest.raises(ValueError, match="expected 6 features, got 1"):
        network.max_value(torch.zeros(4, 3, 1))
    with pytest.raises(ValueError, match="expected actions of shape"):
        call(network, make_observation(4), torch.zeros(4))


def test_docstring():
    outcome = doctest.testmod(marl_lanes.naf.network)
    assert outcome.attempted
    assert not outcome.failed
