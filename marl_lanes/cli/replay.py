"""The command that makes a replay of a trajectory for the browser."""

import argparse

from marl_lanes.cli.arguments import Commands, add_command
from marl_lanes.cli.outputs import check_outputs
from marl_lanes.cli.progress import Progress
from marl_lanes.cli.values import file_name, whole_number
from marl_lanes.terminal import say


def add(commands: Commands) -> None:
    """Add ``replay``."""
    replay = add_command(
        commands,
        "replay",
        _replay,
        summary="make an HTML file that replays a trajectory",
        description="Make one HTML file that replays a road of a trajectory in the browser, also "
        "without a network. docs/replay.md says what one sees.",
        examples="""
            marl-lanes replay roads.parquet --out replay.html
            marl-lanes replay roads.parquet --road 2 --no-optimum --out replay.html
        """,
    )
    replay.add_argument("trajectory", type=file_name, help="a Parquet file")
    replay.add_argument("--out", type=file_name, required=True, help="the HTML file to write")
    replay.add_argument(
        "--road", type=whole_number(), help="index of the road (default: the first one)"
    )
    replay.add_argument(
        "--no-optimum",
        action="store_true",
        help="without the cheapest lane change beside each driven one, which takes a moment",
    )


def _replay(options: argparse.Namespace) -> None:
    # Imported here, because other commands do not need it.
    from marl_lanes.browser.bundle import write_replay
    from marl_lanes.browser.optima import find_optima
    from marl_lanes.trajectory.events import find_commands
    from marl_lanes.trajectory.file import read_trajectory
    from marl_lanes.trajectory.metadata import TrajectoryError

    check_outputs([("--out", options.out)], [options.trajectory])
    trajectory = read_trajectory(options.trajectory)
    if not trajectory.roads:
        raise TrajectoryError(f"{options.trajectory}: has no rows")
    road = trajectory.roads[0] if options.road is None else options.road
    rows = trajectory.rows_of(road)
    optima = None
    if not options.no_optimum:
        with Progress("optimizing", max(1, len(find_commands(rows)))) as show:
            optima = find_optima(rows, trajectory.scenario, progress=show)
    size = write_replay(options.out, trajectory, road, optima) / 1e6
    say(f"{options.out}: road {road} of {len(trajectory.roads)}, {size:.1f} MB")
