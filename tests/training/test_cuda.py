"""A network that learns on a GPU; left out where torch can use none."""

import pytest
import torch
from learners import Evaluation, changers, followers

from marl_lanes.naf.checkpoint import greedy_policy, read_checkpoint

pytestmark = [
    pytest.mark.training,
    pytest.mark.skipif(not torch.cuda.is_available(), reason="torch can use no GPU"),
    pytest.mark.filterwarnings(
        "ignore:Creating .* which inherits from WeightUpdaterBase:DeprecationWarning"
    ),
]


@pytest.mark.parametrize("make", [changers, followers])
@pytest.mark.parametrize("storage", ["memory", "memmap"])
@pytest.mark.parametrize("acting", ["cuda", "cpu"])
def test_it_learns_there_and_its_checkpoint_drives_here(tmp_path, make, storage, acting):
    places = {"device": torch.device("cuda"), "acting_device": torch.device(acting)}
    run = tmp_path / "run"
    short, whole = (f"collector.total_transitions={number}" for number in (150, 300))
    for option in (short, whole):
        learner = make(f"replay.storage={storage}", option, **places)
        if option == short:
            learner.begin(run)
            before = learner.algorithm.network.state_dict()["value.weight_0"].clone()
        else:
            learner.resume(run)
        assert learner.train(Evaluation())
        learner.close()
        assert {one.device.type for one in learner.algorithm.loss.state_dict().values()} == {"cuda"}
    after = learner.algorithm.network.state_dict()["value.weight_0"]
    assert not torch.equal(before, after)
    final = read_checkpoint(run / "checkpoints" / "final.pt").network
    assert next(final.parameters()).device.type == "cpu"
    observations = torch.randn(7, len(final.features)).numpy()
    there, here = (greedy_policy(one)(observations) for one in (learner.algorithm.network, final))
    assert there == pytest.approx(here, abs=1e-4)
