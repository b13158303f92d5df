"""Results as text for a terminal of 120 columns."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

PER_CENT = 100.0
"""The factor from a rate to the number that is shown."""

WIDTH = 120
"""Columns of a terminal."""

CROSSPLAY_ROWS = (
    ("success_rate", "success [%]", 100.0, 1),
    ("completion_rate", "completed [%]", 100.0, 1),
    ("lost_after_rate", "lost afterwards [%]", 100.0, 1),
    ("collided_after_rate", "collided afterwards [%]", 100.0, 1),
    ("left_lane_after_rate", "out of its lane afterwards [%]", 100.0, 1),
    ("abort_rate", "aborted [%]", 100.0, 1),
    ("missed_rate", "missed [%]", 100.0, 1),
    ("abort_or_miss_rate", "aborted or missed [%]", 100.0, 1),
    ("timed_out_rate", "timed out [%]", 100.0, 1),
    ("horizon_rate", "cut off [%]", 100.0, 1),
    ("collision_rate", "collided [%]", 100.0, 1),
    ("off_road_rate", "off the road [%]", 100.0, 1),
    ("mean_time_to_completion", "time to complete [s]", 1.0, 2),
    ("mean_marking_duration", "over the marking [s]", 1.0, 2),
    ("braking_reaches_2_rate", "braking of 2 m/s^2 [%]", 100.0, 1),
    ("braking_reaches_4_rate", "braking of 4 m/s^2 [%]", 100.0, 1),
    ("braking_reaches_8_rate", "braking of 8 m/s^2 [%]", 100.0, 1),
    ("mean_max_follower_braking_all", "follower's braking, mean [m/s^2]", 1.0, 2),
    ("max_follower_braking_all", "follower's braking, largest", 1.0, 2),
    ("mean_imposed_on_follower", "imposed on follower [m/s^2]", 1.0, 2),
    ("mean_imposed_on_changer", "imposed on changer [m/s^2]", 1.0, 2),
    ("mean_drac", "DRAC, mean [m/s^2]", 1.0, 2),
    ("max_drac", "DRAC, largest", 1.0, 2),
    ("min_time_to_collision", "TTC, smallest [s]", 1.0, 2),
    ("critical_time_to_collision_rate", "TTC below 1.5 s [%]", 100.0, 1),
    ("mean_time_exposed", "TET [s]", 1.0, 3),
    ("mean_time_integrated", "TIT [s^2]", 1.0, 3),
    ("mean_post_encroachment_time_follower", "PET, follower [s]", 1.0, 2),
    ("mean_post_encroachment_time_leader", "PET, leader [s]", 1.0, 2),
    ("mean_time_headway_follower", "time headway, follower [s]", 1.0, 2),
    ("mean_time_headway_leader", "time headway, leader [s]", 1.0, 2),
    ("s_critical_violation_rate", "S_critical violated [%]", 100.0, 1),
    ("rss_violation_rate_follower", "RSS violated, follower [%]", 100.0, 1),
    ("rss_violation_rate_leader", "RSS violated, leader [%]", 100.0, 1),
    ("mean_peak_longitudinal_jerk", "longitudinal jerk [m/s^3]", 1.0, 2),
    ("mean_peak_total_lateral_acceleration", "lateral acceleration [m/s^2]", 1.0, 2),
)
"""Key, title, factor and decimals of the rows of a cross-play table."""

_NOT_DEFINED = "-"


def choose_decimals(decimals: int, factor: float, num_maneuvers: int) -> int:
    """The decimals of a number; of a rate in per cent as many as show one maneuver of all.

    Otherwise one failure of 10,000 would look like none.
    """
    if factor != PER_CENT:
        return decimals
    return max(decimals, math.ceil(math.log10(num_maneuvers)) - 2)


def format_estimate(
    estimate: Mapping[str, float | None], factor: float = 1.0, decimals: int = 2
) -> str:
    """``value [low, high]``; without an interval only the value, without a value a dash."""
    value, low, high = (estimate[name] for name in ("value", "low", "high"))
    if value is None:
        return _NOT_DEFINED
    text = f"{factor * value:.{decimals}f}"
    if low is None or high is None:
        return text
    return f"{text} [{factor * low:.{decimals}f}, {factor * high:.{decimals}f}]"


def format_summary(summary: Mapping[str, Any]) -> str:
    """One line per key and value.

    Args:
        summary: of ``evaluate``, with any other entries to show.

    Raises:
        ValueError: it has a cost ratio or a completion rate, but no success rate.
    """
    told = [key for key in ("cost_ratio", "completion_rate") if summary.get(key) is not None]
    if told and summary.get("success_rate") is None:
        raise ValueError(
            f"success_rate = None: must be given together with {' and '.join(told)}, because only "
            "the success rate covers the time after completion"
        )
    width = max(map(len, summary), default=0)
    return "\n".join(
        f"{key:{width}} {value:.5g}" if isinstance(value, float) else f"{key:{width}} {value}"
        for key, value in summary.items()
    )


def format_crossplay(result: Mapping[str, Any]) -> str:
    """One row per statistic and changer, one column per kind of follower.

    Args:
        result: of ``crossplay``.
    """
    cells = {(pair["changer"], pair["followers"]): pair for pair in result["pairs"]}
    rows = []
    for key, title, factor, places in CROSSPLAY_ROWS:
        decimals = choose_decimals(places, factor, result["num_maneuvers"])
        for number, changer in enumerate(result["changers"]):
            values = [
                format_estimate(cells[changer, follower]["statistics"][key], factor, decimals)
                for follower in result["followers"]
            ]
            rows.append(["" if number else title, changer, *values])
    scenarios = ", ".join(dict.fromkeys(result["changers"].values()))
    intro = (
        f"scenario {scenarios}; {result['num_maneuvers']} maneuvers per pair, seed "
        f"{result['seed']}; value [{100.0 * result['confidence']:g} % interval]"
    )
    return intro + "\n\n" + format_table(["", "changer", *result["followers"]], rows, 2)


def format_gaps(result: Mapping[str, Any]) -> str:
    """One row per kind of follower.

    Args:
        result: of ``compare_followers``.
    """
    rows = [
        [
            label,
            format_estimate(found["entered_rate"], 100.0, 1),
            format_estimate(found["gap_at_entry"]),
            format_estimate(found["gap_change"]),
            format_estimate(found["gap_difference"]),
        ]
        for label, found in result["followers"].items()
    ]
    intro = (
        f"scenario {result['scenario']}; {result['num_maneuvers']} maneuvers with each kind, seed "
        f"{result['seed']}; shown: maneuver {result['maneuver']}\n"
        f"{result['num_compared']} engagements are the same with every kind, with the follower "
        f"nearer than {result['near_gap']:g} m; {result['num_entered']} enter the lane with every "
        "kind\n"
        f"mean [{100.0 * result['confidence']:g} % interval]"
    )
    first = next(iter(result["followers"]))
    changes = ["since engagement [m]", f"against {first} [m]"]
    head = ["followers", "entered [%]", "gap at entry [m]", *changes]
    return intro + "\n\n" + format_table(head, rows, 1)


def format_ratings(ratings: Sequence[Mapping[str, Any]]) -> str:
    """One row per player of a league, with the shares of its maneuvers that the rating is from.

    Args:
        ratings: the fields of ``Rating``, of each player.
    """
    rows = []
    for one in ratings:
        shares = [one[key] for key in ("success_rate", "missed_rate", "nobody_rate")]
        value = {"value": one["rating"], "low": one["low"], "high": one["high"]}
        rates = [f"{PER_CENT * share:.1f}" for share in shares]
        rows.append([one["player"], one["role"], format_estimate(value, decimals=0), *rates])
    lost = "missed or timed out [%]"
    head = ["player", "role", "rating", "success [%]", lost, "won by nobody [%]"]
    return format_table(head, rows, 1)


def format_table(head: Sequence[str], rows: Sequence[Sequence[str]], num_labels: int) -> str:
    """Aligned columns, in several blocks if they are wider than the terminal.

    Args:
        head: titles of the columns.
        rows: each as long as ``head``.
        num_labels: number of first columns, which every block repeats.
    """
    widths = [max(map(len, column)) for column in zip(head, *rows, strict=True)]
    labels = list(range(num_labels))
    used = sum(widths[column] + 2 for column in labels)
    blocks: list[list[int]] = [[]]
    room = WIDTH - used
    for column in range(num_labels, len(head)):
        if blocks[-1] and widths[column] > room:
            blocks.append([])
            room = WIDTH - used
        blocks[-1].append(column)
        room -= widths[column] + 2
    lines: list[str] = []
    for block in blocks:
        lines += [""] if lines else []
        for row in (head, *rows):
            cells = [row[column].ljust(widths[column]) for column in (*labels, *block)]
            lines.append("  ".join(cells).rstrip())
    return "\n".join(lines)
