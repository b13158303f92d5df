"""Parameters side by side in one tensor."""

from copy import deepcopy

import torch
from naf.helpers import make_data, make_network

from marl_lanes.naf import NAFLoss
from marl_lanes.naf.joined import (
    join,
    join_parameters,
    joined_runs,
    take_side_by_side,
    whole_of,
)


def test_the_parts_stay_what_they_are_and_are_the_whole():
    matrix, row = torch.arange(6.0).reshape(2, 3), torch.tensor([7.0, 8.0])
    whole = join([matrix, row])
    assert whole.tolist() == [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 7.0, 8.0]
    assert matrix.shape == (2, 3)
    whole.mul_(2.0)
    assert matrix.tolist() == [[0.0, 2.0, 4.0], [6.0, 8.0, 10.0]]
    row.zero_()
    assert whole[-2:].tolist() == [0.0, 0.0]


def test_runs_are_neighbors_in_one_storage():
    first, second = torch.zeros(3), torch.zeros(2, 2)
    alone = torch.zeros(5)
    whole = join([first, second])
    assert sorted(map(sorted, joined_runs([second, alone, first]))) == [[0, 2], [1]]
    (run,) = (run for run in joined_runs([second, alone, first]) if len(run) == 2)
    assert run == [2, 0]
    assert whole_of([first, second]).data_ptr() == whole.data_ptr()
    assert whole_of([first, second]).shape == (7,)
    # One whose numbers lie in another order neither continues nor begins a run.
    memory = torch.zeros(12)
    square = memory[4:8].reshape(2, 2).mT
    assert len(joined_runs([memory[:4], square, memory[8:]])) == 3


def test_tensors_side_by_side_are_not_copied():
    first, second = torch.arange(6.0).split([2, 4])
    second, place = second.view(2, 2), torch.zeros(6)
    assert take_side_by_side([first, second], place).data_ptr() == first.data_ptr()
    assert not place.any()
    # In another order, or apart, they are.
    assert take_side_by_side([second, first], place) is place
    assert place.tolist() == [2.0, 3.0, 4.0, 5.0, 0.0, 1.0]
    assert take_side_by_side([first, second.clone()], place) is place
    assert place.tolist() == [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]


def test_an_optimiser_of_the_whole_does_what_one_of_the_parts_does():
    network = make_network()
    other = deepcopy(network)
    joined = [
        join_parameters([*network.factor_logits.parameters(), *network.value.parameters()]),
        join_parameters(list(network.mu.parameters())),
    ]
    before = [parameter.detach().clone() for parameter in network.parameters()]
    ours = torch.optim.Adam(joined, lr=1e-2)
    theirs = torch.optim.Adam(other.parameters(), lr=1e-2)
    losses = [NAFLoss(one, delay_value=False) for one in (network, other)]
    for _ in range(5):
        data = make_data()
        for block in joined:
            block.grad.zero_()
        theirs.zero_grad()
        for loss in losses:
            loss(data.clone())["loss"].backward()
        for one, same in zip(network.parameters(), other.parameters(), strict=True):
            torch.testing.assert_close(one.grad, same.grad)
        ours.step()
        theirs.step()
    for one, same, start in zip(network.parameters(), other.parameters(), before, strict=True):
        torch.testing.assert_close(one, same, rtol=1e-4, atol=1e-5)
        assert not torch.equal(one, start)
