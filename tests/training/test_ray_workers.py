"""A Ray cluster that collects: two nodes on loopback, a worker on each."""

import os
import signal

import pytest
import torch
from collecting import (
    NUM_ROADS,
    NUM_STEPS,
    assert_same_batch,
    assert_workers_take_the_policy,
    make,
)

from marl_lanes.training.collectors import WorkerError
from marl_lanes.training.config import ConfigError
from marl_lanes.training.workers import RayTrafficCollector

pytest.importorskip("ray", reason="Ray is not installed (extra ray)")
pytestmark = [
    pytest.mark.ray,
    pytest.mark.filterwarnings(
        "ignore:Creating .* which inherits from WeightUpdaterBase:DeprecationWarning"
    ),
    # Raised inside Ray: files and processes that it leaves to the garbage collector.
    pytest.mark.filterwarnings("ignore::ResourceWarning"),
    pytest.mark.filterwarnings("ignore:.*accelerator visible devices.*:FutureWarning"),
]
torch.set_num_threads(1)


@pytest.fixture(scope="module")
def workers(two_nodes):
    collector = make(RayTrafficCollector, 2, two_nodes, num_workers=2)
    yield collector
    collector.shutdown()


@pytest.fixture(scope="module")
def first(workers):
    """The state before the first batch, and that batch."""
    state = workers.state()
    return state, workers.next().clone()


def test_too_many_workers_are_refused(two_nodes):
    with pytest.raises(ConfigError, match="num_workers = 4: must be at most the 2 free CPUs"):
        make(RayTrafficCollector, 4, two_nodes, num_workers=4)


def test_a_cluster_that_is_not_there():
    with pytest.raises(
        ConfigError, match=r"ray\.address = '127\.0\.0\.1:9': must be auto, local or a Ray"
    ):
        make(RayTrafficCollector, 1, "127.0.0.1:9")


def test_each_node_has_a_worker(workers, first):
    import ray

    def node(_):
        return ray.get_runtime_context().get_node_id()

    actors = workers._collector.remote_collectors
    nodes = ray.get([actor.__ray_call__.remote(node) for actor in actors])
    assert len(set(nodes)) == len(nodes) == 2
    assert first[1].shape == (2, NUM_ROADS // 2, NUM_STEPS)


def test_what_is_restored_goes_on_identically(workers, first):
    state, batch = first
    second = workers.next().clone()
    workers.restore(state)
    assert_same_batch(workers.next(), batch)
    assert not torch.equal(second["changers", "action"], batch["changers", "action"])


@pytest.mark.usefixtures("first")
def test_the_policy_reaches_the_workers(workers):
    assert_workers_take_the_policy(workers)


# The last of this module: it ends a worker.
@pytest.mark.usefixtures("first")
def test_a_worker_that_dies_is_named(workers):
    pid = int(workers.places[1].split()[1])
    os.kill(pid, signal.SIGKILL)
    with pytest.raises(WorkerError, match=rf"died: worker 1 of 2 \(process {pid} on "):
        workers.next()
    with pytest.raises(WorkerError, match="worker 1 of 2"):
        workers.state()
