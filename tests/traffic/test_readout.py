"""The columns that the changers are told."""

import numpy as np
import pytest

from marl_lanes.traffic.machine.state import AGENT, Outcome, Phase, structure
from marl_lanes.traffic.readout import read_out


@pytest.mark.parametrize("acts_waiting", [False, True])
def test_every_phase_and_outcome(acts_waiting):
    agents = np.zeros((len(Phase), len(Outcome)), structure(AGENT))
    agents["phase"] = np.arange(len(Phase))[:, None]
    agents["outcome"] = np.arange(len(Outcome))
    agents["reward"] = np.linspace(-1.0, 1.0, agents.size).reshape(agents.shape)
    agents["episode_reward"] = 10.0 * agents["reward"]
    columns = read_out(agents, acts_waiting=acts_waiting)

    def rows(*phases):
        return np.isin(agents["phase"], phases)

    def ends(*outcomes):
        return np.isin(agents["outcome"], outcomes)[..., None]

    live = rows(Phase.WAITING, Phase.ENGAGED, Phase.ABORTING)
    engaged = rows(Phase.ENGAGED, Phase.ABORTING)
    terminated = ends(Outcome.COMPLETED, Outcome.COLLISION, Outcome.OFF_ROAD)
    truncated = ends(Outcome.MISSED, Outcome.HORIZON)
    wanted = {
        "mask": live,
        "engaged": engaged,
        "aborting": rows(Phase.ABORTING),
        "acting": live if acts_waiting else engaged,
        "outcome": agents["outcome"].astype(np.int64),
        "reward": agents["reward"].astype(np.float32)[..., None],
        "episode_reward": agents["episode_reward"].astype(np.float32)[..., None],
        "done": terminated | truncated,
        "terminated": terminated,
        "truncated": truncated,
    }
    assert columns._fields == tuple(wanted)
    for name, values in wanted.items():
        np.testing.assert_array_equal(getattr(columns, name), values, err_msg=name, strict=True)


def test_each_call_gives_arrays_of_its_own():
    agents = np.zeros((2, 3), structure(AGENT))
    first, second = (read_out(agents, acts_waiting=True) for _ in range(2))
    arrays = [*first, *second]
    for place, array in enumerate(arrays):
        assert not any(np.shares_memory(array, other) for other in arrays[place + 1 :])
