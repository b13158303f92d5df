"""Trajectories of driven roads: of an evaluation while it runs, or of one road by itself."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from math import inf
from pathlib import Path

import numpy as np

from marl_lanes.envs.followers import find_policies
from marl_lanes.evaluation.aftermath import WATCHED_TIME
from marl_lanes.evaluation.driving import Policy, drive
from marl_lanes.evaluation.rollout import Maneuver, run_maneuvers
from marl_lanes.memory import check_memory
from marl_lanes.scenario import Scenario, ScenarioError
from marl_lanes.traffic.roles.external import FollowerPolicy
from marl_lanes.traffic.simulator import Simulator
from marl_lanes.trajectory.columns import ROW
from marl_lanes.trajectory.file import Trajectory, TrajectoryWriter, make_trajectory
from marl_lanes.trajectory.frames import FrameReader, Rows
from marl_lanes.trajectory.metadata import Metadata


class RoadRecorder:
    """Reads roads after every step, each at most until WATCHED_TIME after its episode's end.

    Args:
        simulator: that has been reset; it is only read.
        write: takes the rows, (N,) ROW, at first those before the first step.
        roads: indices of the roads within the simulator; by default all.
    """

    def __init__(
        self,
        simulator: Simulator,
        write: Callable[[Rows], object],
        roads: Sequence[int] | None = None,
    ) -> None:
        self._simulator = simulator
        self._write = write
        self._reader = FrameReader(simulator, roads)
        self._num_watched = round(WATCHED_TIME / simulator.scenario.time_step)
        self._last_steps = np.full(simulator.num_envs, np.iinfo(np.int64).max)
        write(self._reader.read())

    @property
    def is_over(self) -> bool:
        """Whether no road is left to record."""
        return not self._reader.roads.size

    def advance(self) -> None:
        """Record the state after a step; to be called after every step."""
        roads = self._reader.roads
        if not roads.size:
            return
        self._write(self._reader.read())
        state = self._simulator.roads[roads]
        end = np.where(state["is_done"], state["step"] + self._num_watched, self._last_steps[roads])
        self._last_steps[roads] = np.minimum(self._last_steps[roads], end)
        is_left = state["step"] < self._last_steps[roads]
        if not is_left.all():
            self._reader = FrameReader(self._simulator, roads[is_left].tolist())


def record_maneuvers(
    path: Path | None,
    name: str,
    scenario: Scenario,
    policy: Policy,
    num_maneuvers: int,
    *,
    seed: int = 0,
    roads: Sequence[int] | None = None,
    follower_policies: Mapping[str, FollowerPolicy] | None = None,
    progress: Callable[[int], object] | None = None,
) -> list[Maneuver]:
    """As ``run_maneuvers``, with the trajectories in a file; the maneuvers are the same.

    Args:
        path: of the Parquet file; None: nothing is recorded.
        name: of the policy, for the file's metadata.
        scenario: as for ``run_maneuvers``, as the next four.
        policy: of the lane changers.
        num_maneuvers: >= 1.
        seed: of the traffic.
        roads: indices of the roads to record; by default all.
        follower_policies: by disposition.
        progress: called after every step with the number of finished commands.

    Raises:
        MissingExtraError: pyarrow is not installed.
        OSError: the file cannot be written.
        ScenarioError, CheckpointError, ValueError: as for ``run_maneuvers``.
    """
    run = partial(
        run_maneuvers,
        scenario,
        policy,
        num_maneuvers,
        seed=seed,
        follower_policies=follower_policies,
        progress=progress,
    )
    if path is None:
        return run()
    with TrajectoryWriter(path, Metadata(scenario, seed, name)) as writer:
        return run(observe=lambda simulator: RoadRecorder(simulator, writer.write, roads).advance)


def record_road(
    scenario: Scenario,
    policy: Policy,
    *,
    seed: int = 0,
    name: str,
    road: int = 0,
    follower_policies: Mapping[str, FollowerPolicy] | None = None,
    last_time: float | None = None,
) -> Trajectory:
    """Drive one road for an episode, and until its last vehicles have settled.

    It is the same road as in an evaluation with the same seed.

    Args:
        scenario: of the road.
        policy: of the lane changers.
        seed: of the traffic, 0 to 2^63 - 1.
        name: of the policy, for the metadata.
        road: index of the road within the seed's roads.
        follower_policies: by disposition; they have priority over registered and saved ones.
        last_time: the recording ends there, if the episode does not end before [s]; needed if the
            scenario's episodes have no end.

    Raises:
        ScenarioError: the episodes have no end and ``last_time`` is None, or a disposition of the
            followers has no policy.
        CheckpointError: the checkpoint of the learned followers cannot be read or does not fit.
        ValueError: seed, road or last_time is out of range, or the rows do not fit in memory.
    """
    if last_time is not None and not 0.0 < last_time < inf:
        raise ValueError(f"last_time = {last_time}: must be above 0")
    has_end = scenario.horizon is not None or (
        scenario.num_agents is not None and scenario.command.probability > 0.0
    )
    if last_time is None and not has_end:
        raise ScenarioError(
            f"scenario {scenario.name!r}: its episodes have no end (num_agents and horizon are "
            "null): a recording needs a last time"
        )
    if not has_end and last_time is not None:
        rows_per_second = scenario.max_vehicles / scenario.time_step
        check_memory("last_time", last_time, last_time * rows_per_second * ROW.itemsize)
    simulator = Simulator(
        scenario,
        seed=seed,
        follower_policies=find_policies(scenario, follower_policies),
        first_road=road,
    )
    simulator.reset()
    last_step = inf if last_time is None else round(last_time / scenario.time_step, 6)
    blocks: list[Rows] = []
    recorder = RoadRecorder(simulator, blocks.append)
    for _ in drive(simulator, policy, needs_agents=last_time is None):
        recorder.advance()
        if recorder.is_over or simulator.roads["step"][0] >= last_step:
            break
    return make_trajectory(Metadata(simulator.scenario, seed, name), blocks)
