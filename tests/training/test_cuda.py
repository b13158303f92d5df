"""A network that learns on a GPU; left out where torch can use none."""

from functools import partial

import pytest
import torch
from learners import Evaluation, changers, check_resuming, filled, followers, tables, weights_of

from marl_lanes.naf.checkpoint import greedy_policy, read_checkpoint
from marl_lanes.training import graphs
from marl_lanes.training.device_collector import DeviceCollector

pytestmark = [
    pytest.mark.training,
    pytest.mark.skipif(not torch.cuda.is_available(), reason="torch can use no GPU"),
    pytest.mark.filterwarnings(
        "ignore:Creating .* which inherits from WeightUpdaterBase:DeprecationWarning"
    ),
]

GPU = torch.device("cuda")


def all_there(*options, seed=0):
    """A learner whose roads, policy, replay and updates are on the GPU."""

    def make_collector(env, policy, num_steps):
        return DeviceCollector(env, policy, num_steps, is_graphed=env.simulator.is_on_gpu)

    places = {"roads": "cuda", "device": GPU, "acting_device": GPU}
    return changers(*options, seed=seed, make_collector=make_collector, **places)


@pytest.mark.parametrize("make", [changers, followers])
@pytest.mark.parametrize("storage", ["memory", "memmap"])
@pytest.mark.parametrize("acting", ["cuda", "cpu"])
def test_it_learns_there_and_its_checkpoint_drives_here(tmp_path, make, storage, acting):
    places = {"device": GPU, "acting_device": torch.device(acting)}
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


def test_a_graph_of_an_update_is_the_update(tmp_path, monkeypatch):
    """Bit for bit, in both stages, with step sizes that fall."""
    found = []
    for name, capture in (("replayed", graphs.capture), ("called", lambda function: function)):
        monkeypatch.setattr(graphs, "capture", capture)
        options = ("optimizer.pretraining_transitions=100", "optimizer.final_rate=0.1")
        learner = filled(tmp_path / name, *options, device=GPU, acting_device=GPU)
        algorithm = learner.algorithm
        torch.manual_seed(9)
        losses = []
        for transitions in (0, 150, 250):
            algorithm.anneal(transitions)
            losses += learner.update(10)["loss"].tolist()
        assert len(algorithm.graphs) == 2
        found.append((losses, weights_of(learner)))
        learner.close()
    (losses, weights), (others, other_weights) = found
    assert losses == others
    assert len(set(losses)) == 30
    assert all(torch.equal(other_weights[key], value) for key, value in weights.items())


@pytest.mark.filterwarnings("ignore:`torch.jit.script_method` is deprecated:DeprecationWarning")
@pytest.mark.filterwarnings("ignore:.*should not be instantiated:DeprecationWarning")
@pytest.mark.filterwarnings("ignore:TensorFloat32 tensor cores:UserWarning")
@pytest.mark.parametrize("compiled", ["false", pytest.param("true", marks=pytest.mark.long)])
def test_networks_together_learn_what_they_learn_one_by_one(tmp_path, compiled):
    """To rounding, in both stages, as graphs; compiled, too."""
    found = []
    for is_batched in (False, True):
        options = [f"optimizer.compile={compiled}"] if is_batched else []
        places = {"device": GPU, "acting_device": GPU, "is_batched": is_batched}
        learner = filled(tmp_path / str(is_batched), *options, **places)
        torch.manual_seed(9)
        losses = []
        for transitions in (0, 150):
            learner.algorithm.anneal(transitions)
            losses += learner.update(10)["loss"].tolist()
        learner.close()
        found.append(losses)
    assert found[1] == pytest.approx(found[0], rel=1e-3)


def test_a_training_on_the_gpu_goes_on_as_if_it_had_not_stopped(tmp_path):
    metrics = check_resuming(tmp_path, partial(all_there, "collector.total_transitions=1500"))
    # After the capture of a batch of steps.
    assert len(metrics) > 8


def test_two_trainings_of_a_seed_on_a_gpu_are_the_same(tmp_path):
    runs = {}
    for name, seed in (("one", 3), ("same", 3), ("other", 4)):
        learner = all_there(seed=seed)
        learner.begin(tmp_path / name)
        assert learner.train(Evaluation())
        learner.close()
        runs[name] = tables(tmp_path / name)
    assert runs["one"] == runs["same"]
    assert runs["one"] != runs["other"]


@pytest.mark.filterwarnings("ignore:Synchronization debug mode:UserWarning")
def test_a_batch_of_steps_and_its_updates_wait_for_nothing(tmp_path):
    learner = all_there()
    learner.begin(tmp_path / "run")
    for _ in range(20):
        learner.algorithm.anneal(200)
        batch = learner.collect()
        learner.experience.extend(learner.algorithm.take_in(batch))
        if len(learner.experience):
            learner.update(4)
    mode = torch.cuda.get_sync_debug_mode()
    try:
        torch.cuda.set_sync_debug_mode("error")
        learner.collector.drive()
        learner.update(70)
    finally:
        torch.cuda.set_sync_debug_mode(mode)
        learner.close()
