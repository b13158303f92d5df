"""What is found with torch's private tables is what is found without them."""

import importlib.util

import pytest
import torch
from naf.paper_networks import make_network
from tensordict import TensorDict
from torch import nn

from marl_lanes.naf import NAFLoss, torch_internals
from marl_lanes.naf.torch_internals import TensorsOf, tensors_by_name


def load_anew():
    spec = importlib.util.spec_from_file_location("anew", torch_internals.__file__)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_this_torch_has_the_tables():
    assert torch_internals.HAS_TABLES


class Without:
    """A module that has none of the tables."""


class WithOther:
    """A module that has something else under their names."""

    def __init__(self):
        self._parameters, self._buffers = [], []


@pytest.mark.parametrize("kind", [Without, WithOther])
def test_a_torch_without_the_tables_is_noticed(kind, monkeypatch):
    assert load_anew().HAS_TABLES
    monkeypatch.setattr(nn, "Module", kind)
    assert not load_anew().HAS_TABLES


@pytest.mark.parametrize("has_tables", [True, False])
@pytest.mark.parametrize("mu", ["paper", "mlp"])
def test_all_tensors_of_a_network(mu, has_tables, monkeypatch):
    monkeypatch.setattr(torch_internals, "HAS_TABLES", has_tables)
    network = make_network(mu)
    found = TensorsOf(network)
    assert list(map(id, found.parameters)) == list(map(id, network.parameters()))
    assert list(map(id, found.buffers)) == list(map(id, network.buffers()))
    heads = network.value
    expected = dict(heads.named_parameters())
    by_name = tensors_by_name(heads, list(expected))
    assert {name: id(value) for name, value in by_name.items()} == {
        name: id(value) for name, value in expected.items()
    }


@pytest.mark.parametrize("has_tables", [True, False])
def test_tensors_that_are_no_parameters(has_tables, monkeypatch):
    monkeypatch.setattr(torch_internals, "HAS_TABLES", has_tables)
    heads = make_network("paper").value
    names = [name for name, _ in heads.named_parameters()]
    others = TensorDict.from_module(heads).detach().clone()
    with others.to_module(heads):
        for name, value in tensors_by_name(heads, names).items():
            assert value.data_ptr() == others[name].data_ptr(), name


@pytest.mark.parametrize("mu", ["paper", "mlp"])
def test_the_loss_and_its_gradients_are_the_same(mu, monkeypatch):
    generator = torch.Generator().manual_seed(0)
    network = make_network(mu)

    def draw(columns):
        return torch.randn(10, columns, generator=generator)

    number = len(network.features)
    ends = {name: draw(1) > 1.0 for name in ("done", "terminated")}
    following = {network.observation_key: draw(number), "reward": draw(1), **ends}
    data = TensorDict(
        {
            network.observation_key: draw(number),
            network.action_key: draw(network.action_dim),
            "next": TensorDict(following, [10]),
        },
        [10],
    )
    loss = NAFLoss(network, delay_value=False)
    loss.make_value_estimator(gamma=0.9)
    results = []
    for has_tables in (True, False):
        monkeypatch.setattr(torch_internals, "HAS_TABLES", has_tables)
        loss.zero_grad()
        value = loss(data.clone())["loss"]
        value.backward()
        results.append([value.detach(), *(one.grad.clone() for one in network.parameters())])
    assert all(map(torch.equal, *results))
