"""Networks evaluated together have the values and gradients of each evaluated alone."""

import pytest
import torch

from marl_lanes.naf.batched import BatchedNetworks, Networks
from marl_lanes.naf.layers import Heads

FIXED = [[0.1], [0.2]]
LEARNING = [[[0.3, 0.0, -0.2]], [[1.0], [2.0], [3.0]]]


def make(initial, hidden=(8, 6)):
    heads = Heads(5, hidden, initial)
    with torch.no_grad():
        for parameter in heads.parameters():
            parameter += 0.3 * torch.randn_like(parameter)
    return Networks(heads, dict(heads.named_parameters()))


def others(networks):
    """Networks of the same form with other parameters, as a target has them."""
    tensors = {name: torch.randn_like(one) for name, one in networks.tensors.items()}
    return Networks(networks.heads, tensors)


def parameters_of(parts):
    return [one for part in parts for one in part.heads.parameters()]


@pytest.mark.parametrize("hidden", [(8, 6), (7,), (4, 4, 4), ()])
@pytest.mark.parametrize("num_chunks", [1, 4])
def test_values_and_gradients_are_those_of_each_alone(hidden, num_chunks):
    learning = [make(initial, hidden) for initial in LEARNING]
    fixed, following = make(FIXED, hidden), others(make([[0.0]], hidden))
    batch = BatchedNetworks(learning, [fixed], [following], num_chunks=num_chunks)
    rows, next_rows = torch.randn(24, 5, requires_grad=True), torch.randn(24, 5)
    found = batch(rows, next_rows)
    wanted = [part.heads(rows) for part in (*learning, fixed)]
    wanted.append(following.heads(next_rows, following.tensors))
    for one, other in zip(found, wanted, strict=True):
        torch.testing.assert_close(one, other)
    assert [one.requires_grad for one in found] == [True, True, False, False]
    leaves = [rows, *parameters_of(learning)]
    gradients = []
    for outputs in (found, wanted):
        total = (outputs[0] * torch.arange(1.0, 4.0)).square().sum() + outputs[1].sin().sum()
        gradients.append(torch.autograd.grad(total, leaves))
    for one, other in zip(*gradients, strict=True):
        torch.testing.assert_close(one, other, rtol=1e-4, atol=1e-5)
        assert one.shape == other.shape


def test_what_gets_no_gradient_has_zeros():
    learning = [make(initial) for initial in LEARNING]
    batch = BatchedNetworks(learning, following=[others(make([[0.0]]))])
    found = batch(torch.randn(3, 5), torch.randn(3, 5))
    gradients = torch.autograd.grad(found[0].sum(), parameters_of(learning))
    count = len([*learning[0].heads.parameters()])
    assert all(one.abs().sum() > 0.0 for one in gradients[:count])
    assert not any(one.any() for one in gradients[count:])


def test_its_second_derivatives_are_refused():
    batch = BatchedNetworks([make(LEARNING[0])], following=[others(make([[0.0]]))])
    rows = torch.randn(3, 5, requires_grad=True)
    found = batch(rows, torch.randn(3, 5))[0].square().sum()
    (gradient,) = torch.autograd.grad(found, rows, create_graph=True)
    with pytest.raises(RuntimeError, match="once_differentiable"):
        gradient.sum().backward()


def test_it_sees_what_becomes_of_the_parameters():
    (learning,) = [make(LEARNING[1])]
    batch = BatchedNetworks([learning], following=[others(make([[0.0]]))])
    rows = torch.randn(3, 5)
    with torch.no_grad():
        for parameter in learning.heads.parameters():
            parameter.mul_(-0.5)
    torch.testing.assert_close(batch(rows, rows)[0], learning.heads(rows))


def test_its_gradients_are_side_by_side():
    learning = [make(initial) for initial in LEARNING]
    batch = BatchedNetworks(learning, following=[others(make([[0.0]]))])
    found = batch(torch.randn(4, 5), torch.randn(4, 5))
    gradients = torch.autograd.grad(found[0].sum() + found[1].sum(), parameters_of(learning))
    ends = [one.data_ptr() + one.nbytes for one in gradients]
    assert ends[:-1] == [one.data_ptr() for one in gradients[1:]]


@pytest.mark.parametrize("other", [make([[0.0]], (8, 7)), make([[0.0]], (8,))])
def test_other_widths_are_refused(other):
    with pytest.raises(ValueError, match="equal input and hidden widths"):
        BatchedNetworks([make(LEARNING[0]), other])
