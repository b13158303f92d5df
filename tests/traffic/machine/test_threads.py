"""Threads: every road once, in forked processes too, and one call at a time."""

import os
import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from forking import exit_code_of_child

from marl_lanes import Simulator
from marl_lanes.traffic.machine import threads
from marl_lanes.traffic.machine.threads import RoadThreads, count_processors


@pytest.mark.parametrize(("num_roads", "num_threads"), [(1, 1), (7, 3), (8, 8)])
def test_every_road_is_in_one_range(num_roads, num_threads):
    counts, names = np.zeros(num_roads, int), set()

    def kernel(start, stop, step):
        counts[start:stop] += step
        names.add(threading.current_thread().name)

    roads = RoadThreads(num_roads, num_threads)
    for _ in range(3):
        roads.run(kernel, 2)
    assert (counts == 6).all()
    assert threading.current_thread().name in names


def test_an_error_of_any_thread_is_raised():
    def kernel(start, _):
        if start > 0:
            raise OSError("thread")

    with pytest.raises(OSError, match="thread"):
        RoadThreads(2, 2).run(kernel)


def test_the_next_call_waits_for_threads_that_an_interruption_left_behind():
    go_on, order = threading.Event(), []

    def slow(start, _):
        if start == 0:
            raise KeyboardInterrupt
        go_on.wait(30.0)
        order.append("slow")

    roads = RoadThreads(2, 2)
    with pytest.raises(KeyboardInterrupt):
        roads.run(slow)
    threading.Timer(0.2, go_on.set).start()
    roads.run(lambda start, _: order.append(start))
    assert order[0] == "slow"
    assert sorted(order[1:]) == [0, 1]


# From Python 3.12 on a fork beside threads is a warning: here it is what is tried.
@pytest.mark.filterwarnings("ignore:.*multi-threaded.*fork:DeprecationWarning")
@pytest.mark.parametrize("is_main", [True, False])
def test_a_forked_process_has_threads_of_its_own(is_main):
    simulator = Simulator("paper", 4, seed=1, num_threads=2)
    simulator.reset()
    twin = Simulator("paper", 4, seed=1, num_threads=1)
    twin.reset()
    for _ in range(3):
        twin.step()

    def work():
        for _ in range(3):
            simulator.step()
        return simulator.state.tobytes() == twin.state.tobytes()

    if is_main:
        assert exit_code_of_child(work) == 0
    else:
        with ThreadPoolExecutor(1) as pool:
            assert pool.submit(exit_code_of_child, work).result() == 0
    # The parent goes on with its own.
    assert simulator.roads["step"].tolist() == [0] * 4
    assert work()


@pytest.mark.filterwarnings("ignore:.*multi-threaded.*fork:DeprecationWarning")
def test_a_process_forked_in_the_midst_of_a_call_is_told_so():
    simulator = Simulator("paper", 2, seed=1)
    simulator.reset()

    def is_refused():
        with pytest.raises(RuntimeError, match=r"^Simulator\.step: another call is in progress"):
            simulator.step()
        return True

    with simulator._lock:
        assert exit_code_of_child(is_refused) == 0


def test_two_threads_at_once_are_an_error_and_never_garbage():
    simulator = Simulator("paper", 2, seed=1)
    simulator.reset()
    twin = Simulator("paper", 2, seed=1)
    twin.reset()
    refused, num_steps = [], []

    def work():
        for _ in range(200):
            try:
                simulator.step()
                num_steps.append(1)
            except RuntimeError as error:
                refused.append(str(error))

    workers = [threading.Thread(target=work) for _ in range(3)]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join()
    for _ in num_steps:
        twin.step()
    assert simulator.state.tobytes() == twin.state.tobytes()
    assert len(num_steps) + len(refused) == 600
    assert simulator.roads["step"].tolist() == [len(num_steps)] * 2
    assert all("another call is in progress" in message for message in refused)


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="needs processor affinity")
def test_affinity_limits_the_threads(monkeypatch):
    usable = os.sched_getaffinity(0)
    assert count_processors() == len(usable)
    one = {min(usable)}
    try:
        os.sched_setaffinity(0, one)
        assert count_processors() == 1
        assert Simulator("paper", 4096, seed=0).num_threads == 1
    finally:
        os.sched_setaffinity(0, usable)
    monkeypatch.setattr("marl_lanes.traffic.simulator.count_processors", lambda: 3)
    assert Simulator("paper", 4096, seed=0).num_threads == 3
    assert Simulator("paper", 2048, seed=0).num_threads == 2
    assert threads.count_processors() == len(usable)
