"""Networks without structure: their initial actions, their bounds, their units."""

import pytest
import torch

from marl_lanes.training.algorithms.actor_critic import ActorNetwork, CriticNetwork

torch.set_num_threads(1)

FEATURES = ["speed", "yaw"]

OFFSETS, SCALES = [20.0, 0.0], [10.0, 0.1]

LOW, HIGH = [-0.5, -5.0], [0.5, 1.0]


@pytest.fixture
def actor():
    torch.manual_seed(0)
    return ActorNetwork(FEATURES, LOW, HIGH, hidden_sizes=(8, 4), offsets=OFFSETS, scales=SCALES)


def observations(*batch):
    return torch.tensor(OFFSETS) + torch.tensor(SCALES) * torch.randn(*batch, 2)


def test_the_first_actions_are_near_zero_or_what_is_nearest(actor):
    """Zero is not the centre of the second action; a third one has no zero."""
    action = actor(observations(5, 40))
    assert action.shape == (5, 40, 2)
    assert (action.abs() < 0.05 * actor.box.half_range).all()
    assert action.std() > 0.0
    brake = ActorNetwork(FEATURES, [-5.0], [-1.0], hidden_sizes=(8, 4))
    assert brake(observations(40)).mean().item() == pytest.approx(-1.2, abs=0.05)


def test_actions_stay_in_the_box_whatever_is_learned(actor):
    with torch.no_grad():
        for parameter in actor.layers.parameters():
            parameter.mul_(1e4)
    action = actor(observations(64))
    assert ((action >= actor.box.low) & (action <= actor.box.high)).all()
    assert (action == actor.box.low).any()
    assert (action == actor.box.high).any()


def test_a_network_from_its_config_acts_alike(actor):
    other = ActorNetwork(**actor.config)
    assert other.config == actor.config
    assert other.hidden_sizes == [8, 4]
    observation = observations(20)
    assert not torch.equal(other(observation), actor(observation))
    other.load_state_dict(actor.state_dict())
    assert torch.equal(other(observation), actor(observation))
    assert torch.equal(actor.policy()(observation=observation), actor(observation))


def test_units_do_not_matter_to_the_critic(actor):
    """The same state and action in other units have the same value."""
    critic = CriticNetwork(actor, [16])
    scaled = ActorNetwork(
        FEATURES,
        [10.0 * low for low in LOW],
        [10.0 * high for high in HIGH],
        offsets=[3.6 * offset for offset in OFFSETS],
        scales=[3.6 * scale for scale in SCALES],
    )
    other = CriticNetwork(scaled, [16])
    other.layers.load_state_dict(critic.layers.state_dict())
    observation = observations(30)
    action = actor.box.low + (actor.box.high - actor.box.low) * torch.rand(30, 2)
    value = critic(observation, action)
    assert value.shape == (30, 1)
    torch.testing.assert_close(other(3.6 * observation, 10.0 * action), value, rtol=1e-4, atol=1e-5)
    assert not torch.allclose(critic(observation, action.flip(0)), value)


def test_the_critic_shares_no_parameters_with_the_actor(actor):
    critic = CriticNetwork(actor, [16])
    own = {parameter.data_ptr() for parameter in critic.parameters()}
    assert not own & {parameter.data_ptr() for parameter in actor.parameters()}
