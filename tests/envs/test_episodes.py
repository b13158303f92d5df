"""What an episode needs, and what a reset cannot change."""

import pytest

from marl_lanes import ScenarioError, load_scenario
from marl_lanes.envs.episodes import check_spaces, count_agents
from marl_lanes.traffic.roles.changer import CHANGER
from marl_lanes.traffic.roles.follower import FOLLOWER


def test_the_agents_of_an_episode_are_counted():
    assert count_agents(load_scenario("paper", {"num_agents": 7})) == 7
    with pytest.raises(ScenarioError, match=r"needs num_agents \(is None\)"):
        count_agents(load_scenario("paper", {"num_agents": None}))


def test_traffic_may_change_and_followers_bounds_only_where_no_follower_is_an_agent():
    made = load_scenario("paper")
    check_spaces(load_scenario("paper", {"horizon": 90.0}), made, (CHANGER, FOLLOWER))
    weak = load_scenario("paper", {"followers": {"external": {"max_braking": 1.0}}})
    check_spaces(weak, made, (CHANGER,))
    trucks = load_scenario("trucks")
    check_spaces(trucks, load_scenario("trucks", {"horizon": 90.0}), (CHANGER,))
    for changed in (weak, load_scenario("paper", {"max_vehicles": 50}), trucks):
        with pytest.raises(ScenarioError, match="must be those that the environment was made with"):
            check_spaces(changed, made, (CHANGER, FOLLOWER))
