"""Collecting in several processes, of this machine or of a Ray cluster.

Whatever the number of workers, the roads are the same: worker w of N has the roads w E/N to
(w + 1) E/N - 1 of the run's seed. Its noise comes from a generator of its own, seeded with the
run's seed and w. Collection is synchronous: a batch holds what all workers collected with the same
policy, in the order of the roads.
"""

import atexit
import importlib.util
import logging
import os
import signal
import socket
import sys
import threading
from abc import abstractmethod
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from multiprocessing import connection
from pathlib import Path
from typing import Any, cast

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torchrl.collectors import MultiCollector
from torchrl.weight_update import SharedMemWeightSyncScheme

from marl_lanes.envs.batched import LaneChangeEnv
from marl_lanes.plugins import import_modules, imported
from marl_lanes.scenario import Scenario
from marl_lanes.training.collectors import (
    OPTIONS,
    LocalCollector,
    MakeCollector,
    TrafficCollector,
    WorkerError,
    WorkerState,
    check_states,
    take_roads,
)
from marl_lanes.training.config import ConfigError, DistributedCollectorConfig
from marl_lanes.training.interruptions import ignore_interruptions


class WorkerEnv(LaneChangeEnv):
    """The roads of one worker. Made in its process, it seeds the process's noise.

    Args:
        worker: its index.
        scenario: of the roads.
        num_envs: roads of each worker.
        seed: of the run.
        learned_followers: as for ``LaneChangeEnv``.
        has_state: as for ``LaneChangeEnv``.
    """

    def __init__(
        self,
        worker: int,
        scenario: Scenario,
        num_envs: int,
        *,
        seed: int,
        learned_followers: bool,
        has_state: bool,
    ) -> None:
        super().__init__(
            scenario,
            num_envs,
            seed=seed,
            num_threads=1,
            learned_followers=learned_followers,
            has_state=has_state,
            first_road=worker * num_envs,
        )
        noise = np.random.SeedSequence(seed, spawn_key=(worker,))
        torch.manual_seed(int(noise.generate_state(1, np.uint64)[0]))

    def place(self) -> str:
        """Which process this is."""
        return f"process {os.getpid()} on {socket.gethostname()}"

    def worker_state(self) -> WorkerState:
        """The roads and the generator of the noise."""
        return {"roads": take_roads(self), "random": torch.get_rng_state()}

    def restore_worker(self, state: WorkerState) -> None:
        """Put both back."""
        self.restore(state["roads"].numpy().tobytes())
        torch.set_rng_state(state["random"])


class Workers(TrafficCollector):
    """What a TorchRL collector of several processes does for us."""

    is_elsewhere = True
    _collector: Any
    _batches: Iterator[TensorDictBase]

    def __init__(self, policy: TensorDictModuleBase, num_workers: int) -> None:
        self.policy = policy
        self.num_workers = num_workers

    def _begin(self) -> None:
        with self._watched():
            self.places = self._collector.map_fn("env.place")
        self._batches = iter(self._collector)

    def next(self) -> TensorDictBase:
        """Send the policy, and gather what each worker does with it, (N, E/N, T)."""
        with self._watched():
            self.send_policy()
            return next(self._batches)

    def send_policy(self) -> None:
        """Copy parameters and buffers of the policy, the noise's sigma among them."""
        self._collector.update_policy_weights_()

    def state(self) -> list[WorkerState]:
        """Of every worker its roads and its generator."""
        with self._watched():
            return cast("list[WorkerState]", self._collector.map_fn("env.worker_state"))

    def restore(self, states: Sequence[WorkerState]) -> None:
        """Put both back in every worker."""
        given = [(state,) for state in check_states(states, self.num_workers)]
        with self._watched():
            self._collector.map_fn("env.restore_worker", given)
            self._collector.map_fn("reset")

    @contextmanager
    def _watched(self) -> Iterator[None]:
        """Turn an error that is a worker's death into one that says so."""
        try:
            yield
        except Exception as error:
            dead = self._find_dead(error)
            if not dead:
                raise
            names = [
                f"worker {index} of {self.num_workers}"
                + (f" ({self.places[index]})" if self.places else " (at its start)")
                + (f" {how}" if how else "")
                for index, how in dead.items()
            ]
            raise WorkerError(f"died: {', '.join(names)}") from error

    @abstractmethod
    def _find_dead(self, error: Exception) -> dict[int, str]:
        """The workers that died first, by index, and how."""


class ProcessCollector(Workers):
    """Collects in processes of this machine, with TorchRL's MultiCollector.

    Args:
        env: pattern of the workers' environments.
        policy: shared with the workers.
        num_steps: time steps of a batch.
        num_workers: number of processes.
    """

    def __init__(
        self, env: LaneChangeEnv, policy: TensorDictModuleBase, num_steps: int, num_workers: int
    ) -> None:
        super().__init__(policy, num_workers)
        self._dead: dict[int, int] = {}
        self._watcher: threading.Thread | None = None
        self._scheme = SharedMemWeightSyncScheme()
        # MultiCollector takes threads away from torch, here and when it ends.
        self._num_threads = torch.get_num_threads()
        self._collector = MultiCollector(
            _worker_envs(env, num_workers),
            policy,
            sync=True,
            frames_per_batch=num_workers * env.simulator.num_envs * num_steps,
            total_frames=-1,
            num_threads=self._num_threads,
            cat_results="stack",
            init_fn=ignore_interruptions,
            weight_sync_schemes={"policy": self._scheme},
            auto_register_policy_transforms=False,
        )
        # Python waits at its end for processes that nobody has ended.
        atexit.register(self.shutdown)
        self._processes = list(self._collector.procs)
        self._watcher = threading.Thread(target=self._watch, daemon=True)
        self._watcher.start()
        self._begin()

    @property
    def process_ids(self) -> list[int]:
        """Of the workers."""
        return [process.pid for process in self._processes]

    def send_policy(self) -> None:
        """Copy parameters and buffers of the policy, in one block of memory.

        TorchRL's own way waits for ever for the answer of a worker that has died; this one ends.
        """
        policy = TensorDict.from_module(self.policy).data.consolidate()
        self._collector.map_fn("update_policy_weights_", [(policy,)] * self.num_workers)

    def shutdown(self) -> None:
        """End the processes."""
        atexit.unregister(self.shutdown)
        self._collector.shutdown()
        # Left to itself it starts a thread when it is collected: at Python's end that hangs.
        self._scheme.shutdown()
        torch.set_num_threads(self._num_threads)

    def _watch(self) -> None:
        """Wait for the first that ends: TorchRL, when it notices, ends the others as well."""
        sentinels = [process.sentinel for process in self._processes]
        ended = connection.wait(sentinels)
        for index, process in enumerate(self._processes):
            if sentinels[index] in ended:
                process.join()
                self._dead[index] = process.exitcode

    def _find_dead(self, error: Exception) -> dict[int, str]:  # noqa: ARG002
        # None while TorchRL starts them: its message says which it was.
        if self._watcher is not None:
            self._watcher.join(timeout=1.0)
        return {
            index: f"by {signal.Signals(-code).name}" if code < 0 else f"with exit code {code}"
            for index, code in self._dead.items()
        }


class RayTrafficCollector(Workers):
    """Collects on a Ray cluster, one CPU a worker, with TorchRL's RayCollector.

    Args:
        env: pattern of the workers' environments.
        policy: sent to the workers.
        num_steps: time steps of a batch.
        num_workers: number of Ray actors.
        address: of the cluster; None: Ray's own search (RAY_ADDRESS, then a cluster on this
            machine), or else a cluster of this machine alone that ends with this process.

    Raises:
        ConfigError: Ray is not installed, there is no cluster, or it has too few free CPUs.
    """

    def __init__(
        self,
        env: LaneChangeEnv,
        policy: TensorDictModuleBase,
        num_steps: int,
        num_workers: int,
        address: str | None,
    ) -> None:
        super().__init__(policy, num_workers)
        if importlib.util.find_spec("ray") is None:
            raise ConfigError(
                "collector.kind = 'ray': must be single or multi without the extra ray"
            )
        import ray
        from torchrl.collectors.distributed import RayCollector

        self._ray = ray
        self._owns_ray = not ray.is_initialized()
        _check_address(address)
        if self._owns_ray:
            try:
                ray.init(address=address, logging_level=logging.WARNING, log_to_driver=False)
            except (ConnectionError, ValueError, RuntimeError) as error:
                reason = " ".join(str(error).split())
                raise ConfigError(
                    f"ray.address = {address!r}: must be a Ray cluster's: {reason}"
                ) from None
        try:
            self._check_cluster()
            self._collector = RayCollector(
                _worker_envs(env, num_workers),
                policy,
                sync=True,
                frames_per_batch=num_workers * env.simulator.num_envs * num_steps,
                # RayCollector takes no -1 for an end that never comes.
                total_frames=sys.maxsize,
                collector_kwargs=[dict(OPTIONS) for _ in range(num_workers)],
                remote_configs=[
                    {"num_cpus": 1, "num_gpus": 0, "scheduling_strategy": "SPREAD"}
                    for _ in range(num_workers)
                ],
            )
            self._begin()
        except BaseException:
            self._disconnect()
            raise

    def shutdown(self) -> None:
        """End the actors, and leave the cluster."""
        self._collector.shutdown()
        self._disconnect()

    def _check_cluster(self) -> None:
        free = int(self._ray.available_resources().get("CPU", 0))
        if free < self.num_workers:
            raise ConfigError(
                f"num_workers = {self.num_workers}: must be at most the {free} free CPUs of the "
                "Ray cluster"
            )

    def _disconnect(self) -> None:
        if self._owns_ray:
            self._ray.shutdown()

    def _find_dead(self, error: Exception) -> dict[int, str]:  # noqa: ARG002
        collector = getattr(self, "_collector", None)
        actors = [] if collector is None else list(collector.remote_collectors)
        dead = {}
        for index, actor in enumerate(actors):
            try:
                self._ray.get(actor.cascade_execute.remote("env.place"), timeout=5.0)
            except self._ray.exceptions.RayActorError:
                dead[index] = ""
            except self._ray.exceptions.GetTimeoutError:
                continue
        return dead


def choose_collector(
    config: DistributedCollectorConfig, num_workers: int, ray_address: str | None
) -> MakeCollector:
    """What makes the collector that is configured."""
    if config.kind == "multi":
        return partial(ProcessCollector, num_workers=num_workers)
    if config.kind == "ray":
        return partial(RayTrafficCollector, num_workers=num_workers, address=ray_address)
    return LocalCollector


def _check_address(address: str | None) -> None:
    """Refuse an address where nobody listens: Ray would try for minutes."""
    if address in {None, "auto", "local"}:
        return
    host, _, port = str(address).rpartition(":")
    try:
        socket.create_connection((host, int(port)), timeout=5.0).close()
    except (OSError, ValueError) as error:
        raise ConfigError(
            f"ray.address = {address!r}: must be auto, local or a Ray cluster's HOST:PORT: {error}"
        ) from None


def _worker_envs(env: LaneChangeEnv, num_workers: int) -> list[Callable[[], WorkerEnv]]:
    """What makes each worker's environment, in its process."""
    return [_MakeEnv(env, worker) for worker in range(num_workers)]


class _MakeEnv:
    """A picklable function. It imports what was imported here: the scenario may need it."""

    def __init__(self, env: LaneChangeEnv, worker: int) -> None:
        self.worker = worker
        self.scenario = env.scenario
        self.num_envs = env.simulator.num_envs
        self.seed = int(env.simulator.roads["random_key"][0])
        self.learned_followers = env.simulator.learned_followers
        self.has_state = env.has_state
        self.modules, self.folder = list(imported), Path.cwd()

    def __call__(self) -> WorkerEnv:
        import_modules(self.modules, self.folder)
        return WorkerEnv(
            self.worker,
            self.scenario,
            self.num_envs,
            seed=self.seed,
            learned_followers=self.learned_followers,
            has_state=self.has_state,
        )
