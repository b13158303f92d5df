"""The reward of a paired driver."""

import pytest
from external_followers import BRAKING, COLLISION, DELAY, DISCOMFORT, pair_of, pay


def test_before_the_body_is_in_the_lane_the_delay_is_rewarded():
    terms = pay(*pair_of(), 0.5)
    assert terms == pytest.approx([DELAY * 0.1, 0.0, 0.0, -DISCOMFORT * 0.25, 0.0])


def test_braking_beyond_hard_braking_costs_reward():
    terms = pay(*pair_of(), -2.5)
    assert terms == pytest.approx([DELAY * 0.1, 0.0, 0.0, -DISCOMFORT * 6.25, -BRAKING * 1.5])


def test_once_the_body_is_in_the_lane_there_is_no_delay():
    terms = pay(*pair_of(lateral=7.0), -0.5)
    assert terms == pytest.approx([0.0, 0.0, 0.0, -DISCOMFORT * 0.25, 0.0])


def test_a_collision_costs_its_penalty():
    simulator, slot = pair_of(gap=1.6, speeds=(25.0, 14.0), lateral=8.5)
    assert simulator.is_follower_acting[0, slot]
    terms = pay(simulator, slot, 3.0)
    assert simulator.roads["num_collisions"][0] == 1
    assert simulator.has_ended[0, slot]
    assert terms == pytest.approx([0.0, 0.0, -COLLISION, -DISCOMFORT * 9.0, 0.0])
