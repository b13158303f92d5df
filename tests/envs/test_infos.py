"""The infos that the environment gives, against their names."""

from marl_lanes import parallel_env
from marl_lanes.envs.infos import info_names


def test_an_info_has_its_names_in_order():
    road = parallel_env("dense", learned_followers=True, seed=0)
    infos = road.reset()[1]
    assert set(infos) == {"changer_0", "follower_0"}
    for agent, info in infos.items():
        assert tuple(info) == info_names(agent)
        assert all(type(value) is float for value in info.values())
