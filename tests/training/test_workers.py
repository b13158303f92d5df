"""Processes that collect: their roads, their noise, their policy, their end."""

import multiprocessing
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import torch
from collecting import (
    BUSY,
    NUM_ROADS,
    NUM_STEPS,
    SEED,
    assert_same_batch,
    assert_workers_take_the_policy,
    make,
)

from marl_lanes import LaneChangeEnv
from marl_lanes.plugins import import_modules
from marl_lanes.traffic.roles.external import _registered
from marl_lanes.training.collectors import LocalCollector, WorkerError
from marl_lanes.training.workers import ProcessCollector, WorkerEnv, _worker_envs

pytestmark = [
    pytest.mark.training,
    pytest.mark.filterwarnings(
        "ignore:Creating .* which inherits from WeightUpdaterBase:DeprecationWarning"
    ),
]
torch.set_num_threads(1)


def worker_env(worker, seed=SEED):
    scenario = LaneChangeEnv("paper", 1, overrides=BUSY, seed=0).scenario
    return WorkerEnv(
        worker, scenario, NUM_ROADS // 2, seed=seed, learned_followers=False, has_state=False
    )


def test_a_worker_imports_what_the_user_has_imported(tmp_path, monkeypatch):
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path)
    text = "from marl_lanes import register_follower\nregister_follower('mine', len)\n"
    Path("their_module.py").write_text(text, encoding="utf-8")
    import_modules(["their_module"])
    mix = {"followers": {"mix": {"mine": 1.0}}}
    make_env, _ = _worker_envs(LaneChangeEnv("paper", 2, overrides=BUSY | mix, seed=0), 2)
    # As in a process that has begun just now, in another folder.
    monkeypatch.chdir("elsewhere")
    del sys.modules["their_module"], _registered["mine"]
    assert make_env().scenario.followers.mix == {"mine": 1.0}
    del sys.modules["their_module"], _registered["mine"]


def test_the_roads_of_the_workers_are_those_of_one_process():
    whole = LaneChangeEnv("paper", NUM_ROADS, overrides=BUSY, seed=SEED)
    parts = [worker_env(worker) for worker in range(2)]
    zero = whole.full_action_spec.zero()
    for env in (whole, *parts):
        env.reset()
    for _ in range(60):
        whole.simulator.step(zero["changers", "action"].numpy())
        for part in parts:
            part.simulator.step()
    for name in ("vehicles", "agents", "roads"):
        table = getattr(whole.simulator.state, name)
        for worker, part in enumerate(parts):
            roads = slice(worker * NUM_ROADS // 2, (worker + 1) * NUM_ROADS // 2)
            assert table[roads].tobytes() == getattr(part.simulator.state, name).tobytes(), name
    assert whole.simulator.is_live.any()


def test_workers_have_the_state_if_their_pattern_has_it():
    for has_state in (True, False):
        pattern = LaneChangeEnv("paper", 2, overrides=BUSY, seed=SEED, has_state=has_state)
        for worker in (make_env() for make_env in _worker_envs(pattern, 2)):
            assert ("state" in worker.reset().keys()) == has_state  # noqa: SIM118


def test_every_worker_has_noise_of_its_own():
    drawn = {}
    for seed in (SEED, SEED + 1):
        for worker in (0, 1):
            worker_env(worker, seed)
            drawn[seed, worker] = torch.randn(5).tolist()
            worker_env(worker, seed)
            assert torch.randn(5).tolist() == drawn[seed, worker]
    assert len({tuple(numbers) for numbers in drawn.values()}) == 4


@pytest.fixture(scope="module")
def workers():
    collector = make(ProcessCollector, 2, num_workers=2)
    yield collector
    collector.shutdown()


@pytest.fixture(scope="module")
def first(workers):
    """The state before the first batch, and that batch."""
    state = workers.state()
    return state, workers.next().clone()


def test_a_batch_is_that_of_one_process_without_noise(workers, first):
    local = make(LocalCollector, sigma=0.0)
    workers.restore(first[0])
    sigma = workers.policy[1].sigma.clone()
    workers.policy[1].sigma.fill_(0.0)
    for _ in range(3):
        one, two = local.next(), workers.next()
        assert two.shape == (2, NUM_ROADS // 2, NUM_STEPS)
        two = two.reshape(NUM_ROADS, NUM_STEPS)
        assert torch.equal(one["changers", "acting"], two["changers", "acting"])
        assert torch.equal(one["next", "changers", "outcome"], two["next", "changers", "outcome"])
        for key in (("changers", "observation"), ("changers", "action")):
            assert torch.allclose(one[key], two[key], atol=1e-5), key
    assert one["changers", "acting"].any()
    workers.policy[1].sigma.copy_(sigma)
    local.shutdown()


def test_what_is_restored_goes_on_identically(workers, first):
    state, batch = first
    assert len(state) == 2
    second = workers.next().clone()
    workers.restore(state)
    assert_same_batch(workers.next(), batch)
    assert not torch.equal(second["changers", "action"], batch["changers", "action"])
    with pytest.raises(ValueError, match="training state of 1 workers: must be of 2"):
        workers.restore(state[:1])


@pytest.mark.usefixtures("first")
def test_the_policy_reaches_the_workers(workers):
    assert_workers_take_the_policy(workers)


# The last of this module: it ends the workers.
@pytest.mark.usefixtures("first")
def test_a_worker_that_dies_is_named(workers):
    assert torch.get_num_threads() == 1
    pids, pid = set(workers.process_ids), workers.process_ids[1]
    assert {child.pid for child in multiprocessing.active_children()} >= pids
    assert str(pid) in workers.places[1]
    os.kill(pid, signal.SIGKILL)
    start = time.monotonic()
    with pytest.raises(WorkerError, match=rf"worker 1 of 2 \(process {pid} on .*\) by SIGKILL"):
        workers.next()
    assert time.monotonic() - start < 60.0
    with pytest.raises(WorkerError, match="worker 1 of 2"):
        workers.state()
    workers.shutdown()
    assert not {child.pid for child in multiprocessing.active_children()} & pids
    assert torch.get_num_threads() == 1


PROGRAM = """
from collecting import make
from marl_lanes.training.workers import ProcessCollector

if __name__ == "__main__":
    collector = make(ProcessCollector, 2, num_workers=2)
    collector.next()
    collector.shutdown()
    # Nobody frees it before Python ends.
    collector.itself = collector
"""


def test_python_ends_after_its_workers(tmp_path):
    file = tmp_path / "program.py"
    file.write_text(PROGRAM, encoding="utf-8")
    path = os.pathsep.join([str(Path(__file__).parents[1]), os.environ.get("PYTHONPATH", "")])
    subprocess.run(
        [sys.executable, str(file)],
        env={**os.environ, "PYTHONPATH": path, "OMP_NUM_THREADS": "1"},
        check=True,
        timeout=100,
        capture_output=True,
    )
