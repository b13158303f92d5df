"""The columns that are read out for changers and followers."""

import numpy as np
import pytest

from marl_lanes.traffic.machine.state import Outcome, Phase
from marl_lanes.traffic.readout import read_changers, read_followers, read_masks
from marl_lanes.traffic.roles.changer import CHANGER
from marl_lanes.traffic.roles.follower import FOLLOWER


@pytest.mark.parametrize("has_longitudinal", [False, True])
def test_every_phase_and_outcome(has_longitudinal):
    agents = np.zeros((len(Phase), len(Outcome)), CHANGER.dtype)
    agents["phase"] = np.arange(len(Phase))[:, None]
    agents["outcome"] = np.arange(len(Outcome))
    agents["reward"] = np.linspace(-1.0, 1.0, agents.size).reshape(agents.shape)
    agents["episode_reward"] = 10.0 * agents["reward"]
    columns = read_changers(agents, has_longitudinal=has_longitudinal)

    def rows(*phases):
        return np.isin(agents["phase"], phases)

    def ends(*outcomes):
        return np.isin(agents["outcome"], outcomes)[..., None]

    live = rows(Phase.WAITING, Phase.ENGAGED, Phase.ABORTING)
    steering = rows(Phase.ENGAGED, Phase.ABORTING)
    terminated = ends(Outcome.COMPLETED, Outcome.COLLISION, Outcome.OFF_ROAD)
    truncated = ends(Outcome.MISSED, Outcome.HORIZON, Outcome.TIMED_OUT)
    wanted = {
        "mask": live,
        "steering": steering,
        "aborting": rows(Phase.ABORTING),
        "acting": live if has_longitudinal else steering,
        "outcome": agents["outcome"].astype(np.int64),
        "reward": agents["reward"].astype(np.float32)[..., None],
        "command_reward": agents["episode_reward"].astype(np.float32)[..., None],
        "done": terminated | truncated,
        "terminated": terminated,
        "truncated": truncated,
    }
    assert list(columns) == list(wanted)
    for name, values in wanted.items():
        np.testing.assert_array_equal(columns[name], values, err_msg=name, strict=True)
    masks = read_masks(agents, has_longitudinal=has_longitudinal)
    for name, values in zip(masks._fields, masks, strict=True):
        key = "mask" if name == "live" else name
        np.testing.assert_array_equal(values, wanted[key], err_msg=name, strict=True)


def test_a_follower_acts_if_a_learner_drives_it_and_ends_with_its_changer():
    agents, followers = np.zeros((1, 4), CHANGER.dtype), np.zeros((1, 4), FOLLOWER.dtype)
    agents["phase"] = [Phase.ENGAGED, Phase.WAITING, Phase.ABSENT, Phase.ABSENT]
    agents["outcome"] = [0, 0, Outcome.COMPLETED, Outcome.MISSED]
    agents["reward"] = 7.0
    followers["policy"] = [1, -1, 0, 1]
    followers["reward"], followers["episode_reward"] = 0.5, 2.0

    columns = read_followers(agents, followers, policy=1)

    assert columns["mask"].tolist() == [[True, True, False, False]]
    assert columns["acting"].tolist() == [[True, False, False, True]]
    assert (columns["reward"] == 0.5).all()
    assert (columns["command_reward"] == 2.0).all()
    assert columns["done"][0, :, 0].tolist() == [False, False, True, True]
    assert columns["terminated"][0, :, 0].tolist() == [False, False, True, False]
    assert columns["truncated"][0, :, 0].tolist() == [False, False, False, True]


def test_each_call_gives_arrays_of_its_own():
    agents = np.zeros((2, 3), CHANGER.dtype)
    first, second = (read_changers(agents, has_longitudinal=True) for _ in range(2))
    arrays = [*first.values(), *second.values()]
    for place, array in enumerate(arrays):
        assert not any(np.shares_memory(array, other) for other in arrays[place + 1 :])
