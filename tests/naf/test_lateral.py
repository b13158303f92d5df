"""The lateral structures of mu: initial values, bounds, and their lane changes."""

import itertools
import math

import pytest
import torch
from naf.paper_networks import (
    OFFSETS,
    PAPER,
    SCALES,
    call,
    make_network,
    make_observation,
    state,
    stir,
)
from tensordict import TensorDict
from torch import nn

from marl_lanes.naf import NAFNetwork
from marl_lanes.naf.lateral import (
    TUNED_CASCADE,
    CascadeGains,
    CascadeMu,
    DampedMu,
    PaperMu,
    steer_by_cascade,
)


def test_initial_paper_mu():
    mu = make_network("paper").mu
    v, dev, psi = 22.0, 3.75, 0.03
    observation = torch.stack(
        [state(lateral_deviation=dev, yaw=psi), state(lateral_deviation=-1.0), state(yaw=-0.02)]
    )
    normalised = (observation - torch.tensor(OFFSETS)) / torch.tensor(SCALES)
    demands = torch.tensor([dev / 3.4**2 - v * psi / 3.4, -1 / 3.4**2, v * 0.02 / 3.4])
    expected = 0.25 * torch.tanh(0.31 * demands)
    found = mu(observation, normalised).squeeze(-1)
    torch.testing.assert_close(found, expected, rtol=0.05, atol=0)
    # The transition time never falls below 1.5 s.
    with torch.no_grad():
        mu.heads.last_bias[2].fill_(-1e30)
        mu.heads.last_bias[1].fill_(math.log(math.expm1(0.31)))
    found = mu(observation, normalised)[1]
    expected = 0.25 * math.tanh(0.31 * -1 / 1.5**2)
    assert found.item() == pytest.approx(expected, rel=0.05)


def test_initial_damped_mu():
    mu = make_network("damped").mu
    observation = torch.stack(
        [
            state(lateral_deviation=0.5, yaw=0.01, yaw_rate=0.004),
            state(speed=0.3, lateral_deviation=0.02),
            state(yaw_rate=0.022, curvature=0.001),
        ]
    )
    p = 1.4
    demands = [p**3 * 0.5 / 22 - 3 * p**2 * 0.01 - 3 * p * 0.004, p**3 * 0.02 / 1.0, 0.0]
    expected = [0.17 * math.tanh(demand / 0.17) for demand in demands]
    normalised = (observation - torch.tensor(OFFSETS)) / torch.tensor(SCALES)
    found = mu(observation, normalised).squeeze(-1)
    torch.testing.assert_close(found, torch.tensor(expected), rtol=0.05, atol=1e-4)


def test_beyond_the_centre_the_damped_mu_rises_to_its_upper_bounds():
    mu = make_network("damped").mu
    observation = torch.stack([state(lateral_deviation=deviation) for deviation in (-0.5, -1.0)])
    normalised = (observation - torch.tensor(OFFSETS)) / torch.tensor(SCALES)
    demands = [((1.4 + share) ** 3 * -share / 22, share) for share in (0.5, 1.0)]
    limits = [0.17 + share * (mu.bound - 0.17) for _, share in demands]
    expected = [
        limit * math.tanh(demand / limit)
        for (demand, _), limit in zip(demands, limits, strict=True)
    ]
    found = mu(observation, normalised).squeeze(-1)
    torch.testing.assert_close(found, torch.tensor(expected), rtol=0.02, atol=0)


def cascade(speed, deviation, yaw, turning, gains):
    """The cascade in plain numbers."""
    speed = max(speed, 1.0)
    wanted = deviation / gains.time**2 - 2.0 * gains.damping * speed * yaw / gains.time
    reference = gains.lateral_limit / speed * math.tanh(wanted / gains.lateral_limit)
    demand = (reference - turning) / gains.lag
    demand = math.copysign(max(abs(demand) - gains.threshold, 0.0), demand)
    return gains.limit * math.tanh(demand / gains.limit)


CASES = [
    # speed, deviation, yaw, yaw rate relative to the road
    (22.0, 3.75, 0.0, 0.0),
    (22.0, 1.0, 0.05, 0.02),
    (28.0, -0.8, -0.03, 0.01),
    (0.3, 0.4, 0.1, 0.0),
    (16.0, 0.2, 0.005, -0.02),
]


def test_the_cascade_is_its_formula():
    gains = CascadeGains(0.4, 1.7, 0.6, 0.2, 0.8, 0.015)
    columns = torch.tensor(CASES, dtype=torch.float64).T[..., None]
    found, slope = steer_by_cascade(*columns, gains)
    expected = [[cascade(*case, gains)] for case in CASES]
    torch.testing.assert_close(found, torch.tensor(expected, dtype=torch.float64))
    assert torch.equal(slope, torch.sign(found))
    assert found.abs().min() > 0.0
    assert found.abs().max() < 0.4


def test_the_cascade_says_exactly_zero_where_little_is_to_be_gained():
    gains = CascadeGains(0.5, 1.53, 0.5, 0.13, 0.687, 0.02)
    # On the reference: w_ref = a_top / v tanh(a_tmp / a_top).
    reference = 0.5 / 22 * math.tanh(1.0 / 1.53**2 / 0.5)
    turning = reference - 0.13 * torch.tensor([0.0, 0.0199, -0.0199, 0.0201, -0.0201])[:, None]
    columns = [torch.full((5, 1), value) for value in (22.0, 1.0, 0.0)]
    found, slope = (part.flatten() for part in steer_by_cascade(*columns, turning, gains))
    assert found[:3].tolist() == [0.0, 0.0, 0.0]
    # The input of the threshold, as a share of it.
    expected = torch.tensor([0.0, 0.995, -0.995, 1.0, -1.0])
    torch.testing.assert_close(slope, expected, atol=1e-3, rtol=0)
    torch.testing.assert_close(found[3:], torch.tensor([1e-4, -1e-4]), rtol=0.1, atol=0)
    # Without a threshold it is the sign of the action.
    _, slope = steer_by_cascade(*columns, turning, gains._replace(threshold=0.0))
    assert slope.flatten().tolist()[1:] == [1.0, -1.0, 1.0, -1.0]


def test_the_cascade_begins_with_the_tuned_gains():
    mu = make_network("cascade").mu
    observation = make_observation(50)
    normalised = (observation - torch.tensor(OFFSETS)) / torch.tensor(SCALES)
    gains = mu.gains(torch.full((50, 1), 22.0), normalised)
    # A sigmoid cannot reach a limit at the bound.
    expected = TUNED_CASCADE._replace(limit=0.45)
    for name, values, value in zip(CascadeGains._fields, gains, expected, strict=True):
        assert values.shape == (50, 1)
        torch.testing.assert_close(values, torch.full((50, 1), value), rtol=0.03, atol=0, msg=name)
    speed, deviation, yaw, yaw_rate = 20.0, 0.5, 0.02, 0.01
    seen = state(
        speed=speed, lateral_deviation=deviation, yaw=yaw, yaw_rate=yaw_rate, curvature=0.002
    )
    normalised = (seen - torch.tensor(OFFSETS)) / torch.tensor(SCALES)
    expected = cascade(speed, deviation, yaw, yaw_rate - 0.002 * speed, expected)
    assert mu(seen, normalised).item() == pytest.approx(expected, rel=0.05)


def test_the_cascades_gains_keep_to_their_ranges():
    gains = extreme_cascades(speed=22.0)
    lowest = CascadeGains(0.2, 1.0, 0.3, 0.08, 0.5, 0.0)
    highest = CascadeGains(0.5, 2.5, 1.0, 0.25, 1.4, 0.05)
    for name, values, low, high in zip(CascadeGains._fields, gains, lowest, highest, strict=True):
        assert (values.min().item(), values.max().item()) == pytest.approx((low, high)), name
    # The threshold suppresses at most the yaw rate for 0.2 m, and 0.3 of the largest one.
    held_back = 22.0 * gains.threshold * gains.lag
    for bound in (0.2 / gains.time.square(), 0.3 * gains.lateral_limit):
        assert (held_back <= bound + 1e-6).all()
        assert (held_back > 0.99 * bound).any()


@pytest.mark.parametrize("mu", ["cascade", "paper", "damped"])
@pytest.mark.parametrize(("low", "high"), [(-0.1, 0.1), (-0.05, 0.5), (-3.0, 3.0)])
def test_structured_mu_keeps_to_the_box(mu, low, high):
    network = NAFNetwork(PAPER, [low], [high], mu=mu, scales=SCALES, offsets=OFFSETS)
    observation = make_observation(200) * 10
    observation[:, PAPER.index("lateral_deviation")].abs_()
    initial = call(network, observation)["greedy_action"].abs().max().item()
    bound = min(-low, high)
    structures = {"cascade": CascadeMu, "paper": PaperMu, "damped": DampedMu}
    expected = min(structures[mu].initial_a_max, 0.9 * bound)
    if mu == "cascade":
        expected = max(expected, 0.4 * bound)
    if mu == "damped":
        expected = max(expected, min(0.03 * 1.4**3 + 0.01 * bound, bound))
    assert initial == pytest.approx(expected, rel=0.05)
    raw = stir(network, 3.0).mu(observation, network.normalise(observation))
    assert (raw >= low).all()
    assert (raw <= high).all()


def lane_change(network, seconds=60.0, dt=0.1, speed=22.0, deviation=3.75, yaw=0.0):
    """The lateral deviations of a vehicle under the greedy policy, semi-implicit Euler."""
    policy = network.policy()
    yaw_rate = 0.0
    deviations = []
    for _ in range(round(seconds / dt)):
        observation = state(lateral_deviation=deviation, yaw=yaw, yaw_rate=yaw_rate)
        with torch.no_grad():
            action = policy(TensorDict({"observation": observation}))["action"].item()
        yaw_rate += action * dt
        yaw += yaw_rate * dt
        deviation -= speed * yaw * dt
        deviations.append(deviation)
    return deviations


def test_cascade_and_damped_mu_settle_and_the_papers_does_not():
    damped = lane_change(make_network("damped"))
    assert max(map(abs, damped[150:])) < 0.01
    assert min(damped) > -0.5
    settled = lane_change(make_network("cascade"))
    # Within the threshold the action is 0.
    assert max(map(abs, settled[150:])) < 0.2
    assert min(settled) > -0.5
    # Without a threshold it steers on, to the centre.
    smooth = lane_change(make_network("cascade-smooth"))
    assert max(map(abs, smooth[150:])) < 0.01 < max(map(abs, settled[150:]))
    paper = lane_change(make_network("paper"), deviation=0.1)
    assert min(paper[:100]) < 0  # it reaches the centre of the lane
    assert max(map(abs, paper[-100:])) > 1.0  # and oscillates ever more widely about it


def test_the_gated_cascade_waits_or_arrives():
    """Open, it is the cascade; closed, it waits, and a change that has begun arrives."""
    network, plain = make_network("cascade-gated"), make_network("cascade")

    def turn_gate(logit):
        with torch.no_grad():
            network.mu.gate.last_bias.fill_(logit)

    turn_gate(1e30)
    # Both begin with the tuned gains, but for what their networks add.
    assert lane_change(network, 20.0) == pytest.approx(lane_change(plain, 20.0), abs=0.1)
    turn_gate(-1e30)
    assert max(abs(value - 3.75) for value in lane_change(network, 10.0)) == 0.0
    # 0.66 m/s toward the target lane, from its own lane, and over the marking.
    for deviation in (3.75, 3.5, 2.8):
        begun = lane_change(network, deviation=deviation, yaw=0.03)
        assert min(begun) > -0.5
        assert max(map(abs, begun[-100:])) < 0.3
    # Away from it: it straightens, and stays where it is but for what is within the threshold.
    away = lane_change(network, 5.0, yaw=-0.01)
    assert 3.6 < away[-1] < 4.25
    # An abort is a short way back.
    back = lane_change(network, deviation=-0.9)
    assert back == pytest.approx(lane_change(plain, deviation=-0.9), abs=0.1)


def test_others_decide_whether_the_gated_cascade_changes_lanes_and_not_how():
    features = [*PAPER, "target_follower_gap"]
    mu = stir(NAFNetwork(features, [-0.5], [0.5], mu="cascade-gated"), 3.0).mu
    seen = torch.cat([make_observation(50), torch.zeros(50, 1)], -1)
    strange = seen.clone()
    strange[:, -1] = 1e6 * torch.randn(50)
    deviation = PAPER.index("lateral_deviation")
    for value, is_same in ((2.0, True), (-0.5, True), (3.75, False)):
        seen[:, deviation] = strange[:, deviation] = value
        assert torch.equal(mu(seen, seen), mu(strange, strange)) == is_same


@pytest.mark.parametrize(("deviation", "share"), [(3.9, 0.5), (3.6, 0.5), (3.45, 0.75), (3.3, 1.0)])
def test_a_begun_change_opens_the_gate(deviation, share, monkeypatch):
    mu = make_network("cascade-gated").mu
    monkeypatch.setattr(mu, "gains", lambda *_: TUNED_CASCADE)
    with torch.no_grad():
        mu.gate.last_bias.fill_(0.0)
    yaw = 0.02
    a_top, time, zeta = 0.58, 1.38, 0.775
    across, straight = (
        a_top / 20.0 * math.tanh((one / time - 2.0 * zeta * 20.0 * yaw) / time / a_top)
        for one in (deviation, 0.0)
    )
    # The yaw rate that is wanted, at which the cascade does not turn.
    rate = share * across + (1.0 - share) * straight
    for beyond in (-0.02, 0.0, 0.02):
        seen = state(speed=20.0, lateral_deviation=deviation, yaw=yaw, yaw_rate=rate - beyond)
        demand = beyond / TUNED_CASCADE.lag
        wanted = math.copysign(max(abs(demand) - TUNED_CASCADE.threshold, 0.0), demand)
        wanted = TUNED_CASCADE.limit * math.tanh(wanted / TUNED_CASCADE.limit)
        found = mu(seen, torch.zeros_like(seen)).item()
        assert found == pytest.approx(wanted, rel=0.01, abs=1e-6)


def test_a_gate_learns_to_close_where_the_cascade_is_saturated():
    """The slope of the action by the gate is that of an open way and a closed one."""
    mu = make_network("cascade-gated").mu
    with torch.no_grad():
        mu.gate.last_bias.fill_(0.0)
        mu.heads.last_bias[2].fill_(-1e30)  # the smallest a_top, 0.3 m/s^2
    seen = state(speed=20.0, lateral_deviation=3.75, yaw=0.0, yaw_rate=-0.005)
    share = torch.sigmoid(mu.sharpness * mu.gate(torch.zeros_like(seen)))
    action = mu(seen, torch.zeros_like(seen))
    (slope,) = torch.autograd.grad(action.sum(), mu.gate.last_bias)
    # Of w_ref by g, a_top / v, over the lag, with the slope of g.
    expected = 0.3 / 20.0 / 0.10 * mu.sharpness * (share * (1.0 - share)).item()
    assert slope.item() == pytest.approx(expected, rel=0.1)


@pytest.mark.parametrize("poles", [-1e30, 1e30])
def test_damped_mu_settles_at_the_ends_of_its_gains(poles):
    network = make_network("damped")
    with torch.no_grad():
        network.mu.heads.last_bias[1:].fill_(poles)
    assert max(map(abs, lane_change(network)[-100:])) < 0.01


def extreme_cascades(speed):
    """Every combination of the bounds of mu cascade's gains, (64, 1) each."""
    ends = torch.tensor(list(itertools.product((-1e30, 1e30), repeat=6)))
    mu = make_network("cascade").mu
    mu.heads = nn.Identity()
    return CascadeGains(*(gain.double() for gain in mu.gains(torch.full((64, 1), speed), ends)))


def drive_by_cascade(gains, deviation, yaw, speed, seconds, dt=0.1):
    """Lateral deviations of a vehicle for each of the gains, (64, steps)."""
    speed = torch.full_like(gains.limit, speed)
    deviation, yaw = (torch.full_like(speed, value) for value in (deviation, yaw))
    yaw_rate = torch.zeros_like(speed)
    deviations = []
    for _ in range(round(seconds / dt)):
        yaw_rate = yaw_rate + steer_by_cascade(speed, deviation, yaw, yaw_rate, gains)[0] * dt
        yaw = yaw + yaw_rate * dt
        deviation = deviation - speed * yaw * dt
        deviations.append(deviation)
    return torch.cat(deviations, dim=1)


@pytest.mark.parametrize(
    ("deviation", "yaw", "room"),
    # A change, and an abort at the marking at 1.1 m/s outward: 3.8 m to the road's edge.
    [(3.75, 0.0, 2.3), (-0.9, 0.05, 4.7)],
)
@pytest.mark.parametrize("speed", [8.0, 22.0, 34.0])
def test_cascade_mu_arrives_whatever_is_learned(deviation, yaw, room, speed):
    gains = extreme_cascades(speed)
    deviations = drive_by_cascade(gains, deviation, yaw * 22.0 / speed, speed, 90.0)
    assert deviations.min() > -room
    at_the_end = deviations[:, -100:].abs().amax(1)
    # Within the threshold the action is 0, at any deviation.
    has_threshold = gains.threshold.flatten() > 1e-6
    assert at_the_end[~has_threshold].max() < 0.01
    assert at_the_end[has_threshold].max() < 0.3


@pytest.mark.parametrize("poles", [-1e30, 0.0, 1.0, 1e30])
def test_damped_mu_brings_a_turned_back_vehicle_home(poles):
    network = make_network("damped")
    with torch.no_grad():
        network.mu.heads.last_bias[0].fill_(-1e30)
        network.mu.heads.last_bias[1:].fill_(poles)
    # At the marking, 1.1 m/s outward: 3.8 m to the road's edge.
    deviations = lane_change(network, deviation=-0.9, yaw=0.05)
    assert min(deviations) > -4.7
    assert max(deviations) < 2.0
    assert max(map(abs, deviations[-100:])) < 0.05
