"""Encoders: what V, M and mu see of stacked observations."""

import pytest
import torch
from tensordict import TensorDict
from torchrl.objectives import SoftUpdate

from marl_lanes.naf import NAFLoss, NAFNetwork
from marl_lanes.naf.encoder import GridEncoder, GRUEncoder, make_encoder

NEWEST = ["speed", "lateral_deviation", "yaw"]
STACKED = NEWEST + [f"{name}@{steps}" for steps in (1, 2, 3) for name in NEWEST]

CELLS = [f"{lane}_{stretch}" for lane in range(3) for stretch in range(20)]
GRIDDED = NEWEST + [f"{kind}_{cell}" for kind in ("occupied", "cell_speed") for cell in CELLS]


def make_network(**options):
    torch.manual_seed(0)
    return NAFNetwork(STACKED, [-0.5], [0.5], mu="paper", encoder="gru", **options)


def observations(num_rows=6):
    return torch.randn(num_rows, 12, generator=torch.Generator().manual_seed(1)) * 0.3


def batch(num_rows=32):
    ends = torch.zeros(num_rows, 1, dtype=torch.bool)
    following = {"observation": observations(num_rows) + 0.1, "reward": torch.ones(num_rows, 1)}
    following |= {"done": ends, "terminated": ends}
    rows = {"observation": observations(num_rows), "action": torch.zeros(num_rows, 1)}
    return TensorDict({**rows, "next": following}, [num_rows])


def test_it_reads_the_oldest_observation_first_and_keeps_the_newest():
    torch.manual_seed(0)
    encoder = GRUEncoder(STACKED)
    seen = observations()
    encoded = encoder(seen)
    assert encoder.outputs[:3] == NEWEST
    assert encoded.shape == (6, len(encoder.outputs))
    assert torch.equal(encoded[:, :3], seen[:, :3])
    plain = torch.nn.GRU(3, GRUEncoder.HIDDEN_SIZE)
    for name, weight in encoder.cell.named_parameters():
        getattr(plain, f"{name}_l0").data.copy_(weight)
    _, state = plain(seen.reshape(6, 4, 3).flip(1).transpose(0, 1))
    torch.testing.assert_close(encoded[:, 3:], state[0])
    assert torch.equal(encoder(seen.reshape(2, 3, 12)), encoded.reshape(2, 3, -1))
    assert torch.equal(encoder(seen[0]), encoder(seen[:1])[0])


def test_the_formula_of_mu_reads_the_newest_observation_alone():
    network = make_network()
    now = torch.tensor([22.0, 3.75, 0.0])
    older = torch.tensor([22.0, -3.75, 0.3]).repeat(3)
    action = network.policy().module(torch.cat([now, older]))
    assert action.item() > 0.01
    swapped = network.policy().module(torch.cat([older[:3], now.repeat(3)]))
    assert swapped.item() < -0.01


def test_values_and_actions_depend_on_the_past():
    network = make_network()
    seen = observations().requires_grad_()
    for value in (network.max_value(seen), network.policy().module(seen)):
        (slope,) = torch.autograd.grad(value.sum(), seen, retain_graph=True)
        assert (slope[:, 3:].abs().amax(0) > 0).all()


def test_the_target_has_its_own_memory():
    network = make_network()
    loss = NAFLoss(network)
    loss.make_value_estimator(gamma=0.9)
    updater = SoftUpdate(loss, tau=0.5)
    seen = observations()
    value = network.max_value(seen)
    loss(batch())["loss"].backward()
    assert all(weight.grad.abs().sum() > 0 for weight in network.encoder.parameters())
    with torch.no_grad():
        for weight in network.encoder.parameters():
            weight.add_(1.0)
    target = loss.target_value_network_params
    assert torch.equal(network.max_value(seen, target), value)
    assert not torch.allclose(network.max_value(seen), value)
    updater.step()
    assert not torch.allclose(network.max_value(seen, target), value)


def test_while_mu_is_frozen_its_action_still_depends_on_the_memory():
    network = make_network()
    network.mu_frozen = True
    loss = NAFLoss(network, delay_value=False)
    loss.make_value_estimator(gamma=0.9)
    loss(batch())["loss"].backward()
    assert all(weight.grad is None for weight in network.mu.parameters())
    assert all(weight.grad is not None for weight in network.encoder.parameters())


def test_a_convolution_reads_all_cells_and_the_formula_none():
    torch.manual_seed(0)
    encoder = GridEncoder(GRIDDED)
    seen = torch.randn(4, 3 + 2 * 3 * 20, requires_grad=True)
    encoded = encoder(seen)
    assert encoder.outputs[:3] == NEWEST
    assert encoded.shape == (4, len(encoder.outputs)) == (4, 3 + 16)
    assert torch.equal(encoded[:, :3], seen[:, :3])
    (slope,) = torch.autograd.grad(encoded[:, 3:].sum(), seen)
    # With steps of two places the last stretches fit no more.
    read = slope[:, 3:].abs().amax(0).reshape(2, 3, 20) > 0
    assert read[..., :13].all()
    # A grid that is a stretch further back is seen one place later.
    cells = torch.zeros(1, 2, 3, 20)
    cells[0, :, 1, 8] = 1.0
    moved = cells.roll(4, -1)
    one, other = (
        encoder(torch.cat([torch.zeros(1, 3), grid.reshape(1, -1)], 1))[:, 3:].reshape(8, 2)
        for grid in (cells, moved)
    )
    torch.testing.assert_close(one[:, 0], other[:, 1])
    assert torch.equal(encoder(seen.reshape(2, 2, -1)), encoded.reshape(2, 2, -1))
    network = NAFNetwork(GRIDDED, [-0.5], [0.5], mu="paper", encoder="grid")
    assert network.mu.columns == [0, 1, 2]
    (slope,) = torch.autograd.grad(network.max_value(seen).sum(), seen)
    assert (slope[:, 3:].abs().amax(0) > 0).sum() > 70


def test_none_gives_the_columns_as_they_are():
    encoder = make_encoder("none", STACKED)
    seen = observations()
    assert encoder.outputs == STACKED
    assert encoder(seen) is seen


@pytest.mark.parametrize(
    ("name", "features", "message"),
    [
        ("lstm", STACKED, "unknown encoder 'lstm', allowed: none, gru, grid"),
        ("gru", NEWEST, "two or more stacked observations, got speed, lateral_deviation, yaw"),
        ("gru", STACKED[:-1], "stacked"),
        ("gru", [*NEWEST, *STACKED[6:], *STACKED[3:6]], "stacked"),
        ("gru", ["speed@1"], "stacked"),
        ("grid", [], "occupancy grid of 13 or more stretches"),
        ("grid", NEWEST, "occupancy grid"),
        ("grid", GRIDDED[1:-1], "occupancy grid"),
        ("grid", [*GRIDDED, *(f"{name}@1" for name in GRIDDED)], "not stacked"),
        ("grid", [*NEWEST, "occupied_0_0", "cell_speed_0_0"], "13 or more stretches"),
    ],
)
def test_what_it_cannot_read_is_refused(name, features, message):
    with pytest.raises(ValueError, match=message):
        make_encoder(name, features)
