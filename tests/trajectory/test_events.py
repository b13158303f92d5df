from collections import Counter

import numpy as np
import pytest
import recordings

from marl_lanes.traffic.machine.state import NONE, Fate, Outcome, Phase
from marl_lanes.trajectory.columns import new_rows
from marl_lanes.trajectory.events import KINDS, Event, find_commands, find_events


def life(vehicle, first_step, **columns):
    """Rows of one vehicle; lists for the columns that change."""
    count = max(len(values) for values in columns.values())
    rows = new_rows(count)
    rows["vehicle"] = vehicle
    rows["step"] = first_step + np.arange(count)
    for name, values in columns.items():
        rows[name] = values
    return rows


W, E, B, X = Phase.WAITING, Phase.ENGAGED, Phase.ABORTING, Phase.ABSENT


def changed(first_step=0, outcome=Outcome.COMPLETED):
    """A vehicle that is commanded, engages, aborts, waits, engages, and ends."""
    return life(
        7,
        first_step,
        command=[NONE, 2, 2, 2, 2, 2, 2, NONE],
        phase=[X, W, E, B, W, E, X, X],
        outcome=[0, 0, 0, 0, 0, 0, outcome, 0],
        num_aborts=[-1, 0, 0, 1, 1, 1, 1, -1],
    )


def test_a_life_in_events():
    found = [(event.step, event.kind) for event in find_events(changed())]
    assert found == [
        (1, "command"),
        (2, "engaged"),
        (3, "aborted"),
        (5, "engaged"),
        (6, "completed"),
    ]


def test_the_order_of_the_rows_does_not_matter():
    rows = np.concatenate([changed(), life(3, 0, speed=[1.0] * 8)])
    assert find_events(rows[::-1]) == find_events(rows)


def test_what_began_before_the_recording_is_no_event():
    """Cut at the step in which it steers: command and first engagement are not known."""
    rows = changed()[2:]
    assert [event.kind for event in find_events(rows)] == ["aborted", "engaged", "completed"]
    (command,) = find_commands(rows)
    assert command.engaged_steps == (5,)


@pytest.mark.parametrize("outcome", [Outcome.MISSED, Outcome.TIMED_OUT, Outcome.HORIZON])
def test_every_end_without_a_change_is_told_by_its_name(outcome):
    assert find_events(changed(outcome=outcome))[-1].kind == outcome.name.lower()


def test_a_loss_after_completion_is_told_with_the_command():
    rows = changed()
    rows["fate"][-1] = Fate.STRAYS
    assert find_events(rows)[-1] == Event(7, "off_road", 7, 2, None)


def test_a_collision_names_both():
    rows = np.concatenate(
        [
            life(1, 0, fate=[0, Fate.COLLIDES], collided_with=[NONE, 9]),
            life(9, 0, fate=[0, Fate.COLLIDES], collided_with=[NONE, 1]),
        ]
    )
    assert find_events(rows) == [
        Event(1, "collision", 1, None, 9),
        Event(1, "collision", 9, None, 1),
    ]


def test_a_command_of_another_vehicle_is_not_taken_over():
    """Rows of different vehicles are neighbors after sorting; no event spans them."""
    rows = np.concatenate([changed(), life(8, 0, speed=[1.0] * 8)])
    rows["fate"][-1] = Fate.STRAYS
    assert find_events(rows)[-1].command is None


def test_the_life_of_a_command():
    (command,) = find_commands(changed(first_step=10, outcome=Outcome.MISSED))
    assert command == (2, 7, 11, (12, 15), 16, Outcome.MISSED, 1)


def test_no_rows_have_no_events():
    assert find_events(new_rows(0)) == []
    assert find_commands(new_rows(0)) == []


@pytest.mark.parametrize("recorded", [recordings.paper, recordings.interactive])
def test_events_of_a_road_agree_with_its_counters(recorded):
    rows = recorded().rows
    counts = Counter(event.kind for event in find_events(rows))
    commands = find_commands(rows)
    assert counts["command"] == len(commands) == rows["command"].max() + 1
    for outcome in (Outcome.COMPLETED, Outcome.MISSED):
        assert counts[outcome.name.lower()] == sum(one.outcome == outcome for one in commands)
    assert counts["aborted"] == sum(one.num_aborts for one in commands)
    assert counts["engaged"] == sum(len(one.engaged_steps) for one in commands)
    assert counts["completed"] >= 3
    assert set(counts) <= set(KINDS)


def test_events_of_lost_vehicles_agree_with_the_rows():
    trajectory = recordings.crashes()
    counts = Counter()
    for road in trajectory.roads:
        counts.update(event.kind for event in find_events(trajectory.rows_of(road)))
    assert counts["off_road"] == (trajectory.rows["fate"] == Fate.STRAYS).sum() > 0
    assert counts["collision"] == (trajectory.rows["fate"] == Fate.COLLIDES).sum() > 0
