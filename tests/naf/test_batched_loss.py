"""The loss in few kernels has the values and gradients of `NAFLoss`, for every structure of mu."""

from contextlib import contextmanager

import pytest
import torch
from elsewhere import ELSEWHERE, NoHost
from naf import paper_networks, two_actions
from tensordict import TensorDict
from torchrl.objectives import SoftUpdate, ValueEstimators

from marl_lanes.naf import NAFLoss, NAFNetwork
from marl_lanes.naf.batched_loss import BatchedNAFLoss
from marl_lanes.naf.layers import Heads
from marl_lanes.naf.mu import LATERAL

ROWS = 256
GRID = [*two_actions.FEATURES, *(f"occupied_0_{i}" for i in range(13))]
GRID += [f"cell_speed_0_{i}" for i in range(13)]
FORMS = {
    **{mu: (mu, 1, {}) for mu in [*LATERAL, "mlp"]},
    **{f"{mu} of two": (mu, 2, {}) for mu in [*two_actions.COMPOSED, "mlp"]},
    "costs": ("cascade", 1, {"action_costs": [2.0]}),
    "diagonal": ("paper+idm", 2, {"off_diagonal": False}),
    "one layer": ("paper", 1, {"hidden_sizes": (12,)}),
    "gru": ("cascade", 1, {"encoder": "gru", "num_stacked": 2}),
    "grid": ("paper+idm", 2, {"encoder": "grid", "features": GRID}),
}


def make_form(form):
    mu, actions, options = FORMS[form]
    options = dict(options)
    stacked = options.pop("num_stacked", 1)
    features = options.pop("features", two_actions.FEATURES)
    features = features + [f"{name}@{i}" for i in range(1, stacked) for name in features]
    low, high = ((-0.5, -3.0)[:actions], (0.5, 2.0)[:actions])
    options = {"hidden_sizes": (16, 16), **options}
    network = NAFNetwork(features, list(low), list(high), mu=mu, **options)
    return paper_networks.stir(network, 0.2)


def make_rows(network, *batch):
    def draw(*shape):
        return torch.randn(*batch, *shape)

    box = network.box
    ends = {key: draw(1) > 0.7 for key in ("done", "terminated")}
    speeds = torch.tensor([20.0 * name.startswith("speed") for name in network.features])
    following = {"observation": speeds + draw(len(network.features)), "reward": draw(1), **ends}
    rows = {
        "observation": speeds + draw(len(network.features)),
        "action": box.low + 2 * box.half_range * torch.rand(*batch, network.action_dim),
        "next": TensorDict(following, batch),
    }
    return TensorDict(rows, batch)


def make_both(network, batch_size=ROWS, **options):
    """The plain loss and the batched one, of one network and with equal targets."""
    losses = NAFLoss(network, **options), BatchedNAFLoss(network, **options)
    SoftUpdate(losses[0], eps=0.5)
    for parameter in losses[0].target_value_network_params.values(True, True):
        if parameter.is_floating_point() and parameter.ndim > 1:
            parameter.data += 0.1 * torch.randn_like(parameter)
    SoftUpdate(losses[1], eps=0.5)
    losses[1].load_state_dict(losses[0].state_dict())
    losses[1].batch_networks(batch_size)
    return losses


@contextmanager
def evaluated_alone(network):
    """The networks that evaluate themselves in the block, as often as they do."""
    found = []

    def note(heads, given, _):
        if heads.given is None or heads.given[0] is not given[0]:
            found.append(heads)

    heads = [one for one in network.modules() if isinstance(one, Heads)]
    hooks = [one.register_forward_hook(note) for one in heads]
    yield found
    for hook in hooks:
        hook.remove()


def check_same(losses, rows, *, frozen=False):
    """Values, priorities and gradients agree; returns how often networks were evaluated alone."""
    network = losses[0].value_network
    network.mu_frozen = frozen
    parameters = [
        one for name, one in network.named_parameters() if not (frozen and name.startswith("mu."))
    ]
    found, alone = [], []
    for loss in losses:
        given = rows.clone()
        with evaluated_alone(network) as heads:
            value = loss(given)["loss"]
        alone.append(len(heads))
        gradients = torch.autograd.grad(value.sum(), parameters, materialize_grads=True)
        found.append((value.detach(), given["td_error"], gradients))
    (value, priority, gradients), (other, other_priority, other_gradients) = found
    torch.testing.assert_close(other, value)
    torch.testing.assert_close(other_priority, priority, rtol=1e-4, atol=1e-5)
    for one, expected in zip(other_gradients, gradients, strict=True):
        size = max(1e-6, expected.abs().max().item())
        assert (one - expected).abs().max() < 2e-5 * size
    assert all(one.given is None for one in network.modules() if isinstance(one, Heads))
    return alone


@pytest.mark.parametrize("frozen", [False, True])
@pytest.mark.parametrize("form", FORMS)
def test_every_form_has_the_same_loss_and_gradients(form, frozen):
    network = make_form(form)
    rows = make_rows(network, ROWS)
    plain, batched = check_same(make_both(network), rows, frozen=frozen)
    # What reads something else than the encoded observation is evaluated alone.
    masked = form.startswith("cascade-gated")
    number = sum(isinstance(one, Heads) for one in network.modules())
    assert (plain, batched) == (number + 1, 1 if masked else 0)


@pytest.mark.filterwarnings("ignore:No target network updater:UserWarning")
@pytest.mark.parametrize("num_steps", [1, 3])
@pytest.mark.parametrize("kind", [NAFLoss, BatchedNAFLoss])
@pytest.mark.parametrize("form", FORMS)
def test_on_another_device_it_needs_nothing_of_the_host(form, kind, num_steps):
    """An update on a GPU would wait for it; as a graph it would fail."""
    rows = make_rows(make_form(form), ROWS)
    if num_steps > 1:
        rows["steps_to_next_obs"] = torch.full((ROWS, 1), num_steps)
    loss = kind(make_form(form).to(ELSEWHERE))
    loss.make_value_estimator(gamma=0.9)
    if kind is BatchedNAFLoss:
        loss.batch_networks(ROWS)
    parameters = [*loss.value_network.parameters()]
    rows = rows.to(ELSEWHERE)
    with NoHost():
        value = loss(rows)["loss"]
        gradients = torch.autograd.grad(value, parameters, torch.ones_like(value))
    assert {one.device for one in [value, *gradients]} == {ELSEWHERE}


@pytest.mark.parametrize("reduction", ["mean", "sum", "none"])
@pytest.mark.parametrize("distance", ["l1", "l2", "smooth_l1"])
def test_reductions_and_distances(reduction, distance):
    network = make_form("cascade+idm of two")
    losses = make_both(network, reduction=reduction, loss_function=distance)
    check_same(losses, make_rows(network, ROWS))


def test_weights_masks_and_several_steps():
    network = make_form("paper")
    rows = make_rows(network, ROWS)
    rows["priority_weight"] = torch.rand(ROWS)
    rows["steps_to_next_obs"] = torch.randint(1, 4, (ROWS, 1))
    rows["mask"] = torch.rand(ROWS) > 0.3
    losses = make_both(network)
    for loss in losses:
        loss.make_value_estimator(gamma=0.9)
        loss.loss_mask_key = "mask"
    before = check_same(losses, rows)
    assert before[1] == 0


def test_rows_that_do_not_fit_are_evaluated_as_ever():
    network = make_form("paper")
    losses = make_both(network)
    assert check_same(losses, make_rows(network, 2 * ROWS))[1] == 0
    for shape in ((ROWS - 1,), (4, 64)):
        rows = make_rows(network, *shape)
        plain, batched = check_same(losses, rows)
        assert plain == batched > 0
    for loss in losses:
        loss.make_value_estimator(ValueEstimators.TDLambda, gamma=0.9, lmbda=0.8)
    rows = make_rows(network, 8, 32)
    rows.names = [None, "time"]
    check_same(losses, rows)


@pytest.mark.parametrize("batch_size", [1, 100, 512])
def test_any_batch_size_is_fine(batch_size):
    network = make_form("cascade")
    losses = make_both(network, batch_size)
    assert losses[1].batches[False].num_chunks == (4 if batch_size == 512 else 1)
    assert check_same(losses, make_rows(network, batch_size))[1] == 0


def test_a_mu_that_may_leave_the_box_is_evaluated_as_ever():
    """The maximum is not V there: `NAFLoss` knows what it is."""
    network = make_form("mlp")
    network.mu.inside_box = False
    losses = make_both(network)
    assert losses[1].batches == {}
    plain, batched = check_same(losses, make_rows(network, ROWS))
    assert plain == batched > 0


def test_its_state_is_that_of_the_plain_loss():
    plain, batched = make_both(make_form("cascade-gated"))
    assert plain.state_dict().keys() == batched.state_dict().keys()
    assert plain.in_keys == batched.in_keys
