"""The command that records a policy on seeded traffic: films, stills, data."""

import argparse
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from marl_lanes.cli.arguments import Commands, add_command, add_followers, add_scenario, add_seed
from marl_lanes.cli.completers import offer, policies
from marl_lanes.cli.outputs import check_outputs
from marl_lanes.cli.policies import TRAINED, UNTRAINED
from marl_lanes.cli.progress import Progress
from marl_lanes.cli.tracks import RECORDED, Track, make_tracks, read_inputs
from marl_lanes.cli.values import file_name, number, whole_number
from marl_lanes.extras import need
from marl_lanes.plugins import add_import, import_modules
from marl_lanes.rendering.options import SPAN, SPEED, ViewOptions
from marl_lanes.scenario.messages import shown
from marl_lanes.terminal import say

if TYPE_CHECKING:
    from marl_lanes.rendering.excerpt import Excerpt

FILMS = (".mp4", ".gif")
STILL = ".png"
DATA = (".parquet", ".csv", ".fcd.xml")
SUFFIXES = (*FILMS, STILL, *DATA)

MAX_TIME = 1e9
"""[s] A limit for what is typed; episodes end long before."""

_ROUNDING = 1e-6
"""[s]"""


def add(commands: Commands) -> None:
    """Add ``record``."""
    record = add_command(
        commands,
        "record",
        _record,
        summary="make films, stills and data of a policy",
        description="Drive one road for an episode and record it. A film shows the first lane "
        "change that is completed, from 2 s before its engagement to 3 s after it, unless "
        "--maneuver, --follow changer_K, or --start and --seconds choose another part. Data files "
        "have the whole episode, or the part of --maneuver, or of --start and --seconds. Several "
        "policies or followers go side by side, on one clock; then there is one data file for "
        "each, with its label in the name.",
        examples="""
            marl-lanes record tuned-cascade --out film.mp4
            marl-lanes record zoo:paper --scenario dense --seed 3 --out film.gif
            marl-lanes record tuned-cascade --scenario dense --followers cooperative \\
                neutral adversarial --out side_by_side.mp4
            marl-lanes record tuned-cascade --scenario dense --maneuver 4 --out film.mp4 \\
                --out road.parquet
            marl-lanes record road.parquet --at 41.5 --out still.png
            marl-lanes record runs/paper/trajectories/*.parquet --maneuver 0 \\
                --out training.mp4
        """,
    )
    policy = record.add_argument(
        "policies",
        nargs="+",
        metavar="POLICY",
        help=f"{', '.join(UNTRAINED)}, {TRAINED}; POLICY@SCENARIO; or a recorded trajectory "
        f"(*{RECORDED}), which is not simulated again",
    )
    offer(policy, policies)
    record.add_argument(
        "--out",
        action="append",
        required=True,
        type=file_name,
        metavar="FILE",
        help=f"the suffix chooses: {', '.join(SUFFIXES)}; may be given several times",
    )
    add_scenario(record, default=None)
    add_seed(record, default=None)
    record.add_argument(
        "--road",
        type=whole_number(),
        help="index of the road within the seed's roads, as in an evaluation (default: 0, or the "
        "first that is recorded)",
    )
    add_followers(record)
    add_import(record)
    _add_part(record)
    _add_view(record)


def _add_part(record: argparse.ArgumentParser) -> None:
    time = number(0.0, MAX_TIME, unit=" s")
    part = record.add_argument_group("which part")
    part.add_argument("--maneuver", type=whole_number(), metavar="K", help="that of changer_K")
    part.add_argument(
        "--start",
        type=time,
        metavar="S",
        help="first time [s] (default: 0)",
    )
    part.add_argument(
        "--seconds",
        type=time,
        metavar="S",
        help="how long (default: to the end)",
    )
    part.add_argument(
        "--at",
        type=time,
        metavar="S",
        help=f"time of a {STILL} [s] (default: when the vehicle crosses the marking)",
    )


def _add_view(record: argparse.ArgumentParser) -> None:
    view = record.add_argument_group("view")
    view.add_argument(
        "--size",
        metavar="WxH",
        help="pixels of the whole picture (default: 1280x720, .gif 800x450; higher for several)",
    )
    view.add_argument(
        "--span",
        type=number(*SPAN, unit=" m"),
        metavar="M",
        help="metres of road (default: 140)",
    )
    view.add_argument(
        "--follow",
        metavar="WHOM",
        help="changer_3, or a vehicle's number (default: the maneuver's vehicle)",
    )
    view.add_argument(
        "--speed", type=number(*SPEED), metavar="X", help="1 is real time (default: 1)"
    )


@dataclass(frozen=True)
class _Part:
    """What is shown: the time from start to end [s], of a maneuver if there is one."""

    start: float
    end: float
    excerpt: "Excerpt | None" = None


def _record(options: argparse.Namespace) -> None:
    inputs = read_inputs(options.policies, options.followers, options.scenario)
    check_outputs([("--out", path) for path in options.out], inputs)
    outputs = {path: _suffix_of(path) for path in options.out}
    _check_times(options, is_still=STILL in outputs.values())
    given = _read_view(options)
    followed = ViewOptions.make(given).followed_command
    views = _choose_views(outputs, given, len(options.policies) * len(options.followers or [""]))
    import_modules(options.modules)
    last_time = None
    if options.seconds is not None:
        last_time = (options.start or 0.0) + options.seconds
    tracks = make_tracks(
        options.policies,
        options.followers,
        scenario=options.scenario,
        seed=options.seed,
        road=options.road,
        maneuver=options.maneuver,
        last_time=last_time,
    )
    _check_followed(tracks, given.get("follow"), followed)
    part = _choose_part(tracks, options, followed)
    written: list[Path] = []
    for path, suffix in outputs.items():
        if suffix in DATA:
            is_whole = options.maneuver is None and options.start is None and last_time is None
            written += _write_data(path, suffix, tracks, None if is_whole else part)
        else:
            _show(path, tracks, part, views[path], options.at, followed)
            written.append(path)
    say("\n".join(map(str, written)))


def _suffix_of(path: Path) -> str:
    for suffix in SUFFIXES:
        if path.name.lower().endswith(suffix) and len(path.name) > len(suffix):
            return suffix
    raise ValueError(f"--out {path}: must end in {', '.join(SUFFIXES)}")


def _check_times(options: argparse.Namespace, *, is_still: bool) -> None:
    for name in ("start", "seconds", "at"):
        value = getattr(options, name)
        if value is None:
            continue
        if name == "seconds" and value == 0.0:
            raise ValueError(f"--{name} {value:g}: must be above 0")
        if name != "at" and options.maneuver is not None:
            raise ValueError(f"--{name} {value:g}: not with --maneuver, which chooses the time")
    if options.at is not None and not is_still:
        raise ValueError(f"--at {options.at:g}: is the time of a {STILL}, which no --out names")


def _read_view(options: argparse.Namespace) -> dict[str, Any]:
    """The fields of the view that are given."""
    given: dict[str, Any] = {}
    if options.size is not None:
        match = re.fullmatch(r"([0-9]{1,5})x([0-9]{1,5})", options.size)
        if match is None:
            raise ValueError(f"--size {shown(options.size)}: must be WxH, for example 1280x720")
        given["size"] = int(match[1]), int(match[2])
    if options.follow is not None:
        is_number = options.follow.isascii() and options.follow.isdecimal()
        given["follow"] = int(options.follow) if is_number else options.follow
    for name in ("span", "speed"):
        if getattr(options, name) is not None:
            given[name] = getattr(options, name)
    return given


def _choose_views(
    outputs: Mapping[Path, str], given: Mapping[str, Any], number: int
) -> dict[Path, ViewOptions]:
    """The options of the view for each picture of the roads, checked before anything is driven."""
    if any(suffix in DATA for suffix in outputs.values()):
        need("pyarrow", "view")
    pictures = [path for path, suffix in outputs.items() if suffix not in DATA]
    if not pictures:
        return {}
    need("imageio_ffmpeg", "view")
    from marl_lanes.rendering.film import arrange, choose_size

    views = {}
    for path in pictures:
        view = ViewOptions.make({"size": choose_size(path, number), **given})
        arrange(number, view.size)
        views[path] = view
    return views


def _check_followed(tracks: Sequence[Track], follow: str | int | None, command: int | None) -> None:
    """Reject whom no road has: the picture would show somebody else."""
    if follow is None:
        return
    column, number = ("vehicle", follow) if command is None else ("command", command)
    if not any((track.rows[column] == number).any() for track in tracks):
        raise ValueError(f"--follow {follow}: must be on a recorded road")


def _choose_part(
    tracks: Sequence[Track], options: argparse.Namespace, followed: int | None
) -> _Part:
    from marl_lanes.rendering.excerpt import find_excerpt

    times = [track.rows["time"] for track in tracks]
    first, last = min(float(one[0]) for one in times), max(float(one[-1]) for one in times)
    for name in ("start", "at"):
        value = getattr(options, name)
        if value is not None and not first <= value + _ROUNDING <= last + 2 * _ROUNDING:
            raise ValueError(
                f"--{name} {value:g}: recorded is the time from {first:g} to {last:g} s"
            )
    is_timed = options.start is not None or options.seconds is not None
    if is_timed:
        start = first if options.start is None else options.start
        return _Part(start, last if options.seconds is None else start + options.seconds)
    if options.at is not None and options.maneuver is None:
        return _Part(first, last)
    command = followed if options.maneuver is None else options.maneuver
    excerpt = find_excerpt([track.rows for track in tracks], command)
    if excerpt is None:
        return _Part(first, last)
    return _Part(excerpt.start, excerpt.end, excerpt)


def _choose_time(tracks: Sequence[Track], part: _Part) -> float:
    """When the maneuver's vehicle crosses the marking, or the middle of what is shown [s]."""
    from marl_lanes.rendering.excerpt import find_crossing

    if part.excerpt is None:
        return 0.5 * (part.start + part.end)
    return find_crossing(tracks[0].rows, part.excerpt)


def _find_vehicle(track: Track, command: int, time: float) -> int | None:
    """Vehicle of a command that was given before the time; of a later one, what is drawn tells."""
    rows = track.rows[track.rows["command"] == command]
    rows = rows[rows["time"] < time]
    return int(rows["vehicle"][0]) if rows.size else None


def _show(
    path: Path,
    tracks: Sequence[Track],
    part: _Part,
    view: ViewOptions,
    at: float | None,
    followed: int | None,
) -> None:
    """Write a film or a still; ``followed`` is the command whose vehicle is to be followed."""
    from marl_lanes.rendering.film import cut, write_film, write_still

    excerpt, time = part.excerpt, None
    if path.suffix.lower() == STILL:
        time = _choose_time(tracks, part) if at is None else at
    vehicles: Sequence[int | None] = [None] * len(tracks)
    if followed is not None:
        first = part.start if time is None else time
        vehicles = [_find_vehicle(track, followed, first) for track in tracks]
    elif excerpt is not None and view.follow is None:
        vehicles = excerpt.vehicles
    clips = [
        cut(
            track.label,
            track.trajectory.frames(track.road),
            part.start,
            part.end if at is None else max(part.end, at),
            vehicle,
        )
        for track, vehicle in zip(tracks, vehicles, strict=True)
    ]
    if time is not None:
        write_still(path, clips, time, view)
        return
    with Progress(f"filming {path.name}", 100) as show:
        write_film(path, clips, view, progress=lambda count, total: show(100 * count // total))


def _write_data(path: Path, suffix: str, tracks: Sequence[Track], part: _Part | None) -> list[Path]:
    """Write a file for each track; returns their paths."""
    from marl_lanes.trajectory.exports import write_csv, write_fcd
    from marl_lanes.trajectory.file import Trajectory, write_trajectory

    writers = {".parquet": write_trajectory, ".csv": write_csv, ".fcd.xml": write_fcd}
    written = []
    for track in tracks:
        rows = track.rows
        if part is not None:
            is_in = (rows["time"] >= part.start - _ROUNDING) & (
                rows["time"] <= part.end + _ROUNDING
            )
            rows = rows[is_in]
        name = path.name
        if len(tracks) > 1:
            name = f"{name[: -len(suffix)]}-{track.file_label}{name[-len(suffix) :]}"
        written.append(path.with_name(name))
        writers[suffix](written[-1], Trajectory(track.trajectory.metadata, rows))
    return written
