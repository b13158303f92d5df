from marl_lanes.traffic.machine.state import NONE, Fate, Outcome, Phase
from marl_lanes.trajectory.appearance import (
    BRAKE_LIGHT,
    indicated_side,
    is_braking,
    is_commanded,
    is_lost,
)
from marl_lanes.trajectory.columns import new_rows


def make_rows(*vehicles):
    rows = new_rows(len(vehicles))
    for row, columns in zip(rows, vehicles, strict=True):
        for name, value in columns.items():
            row[name] = value
    return rows


def test_a_changer_indicates_the_way_that_it_takes():
    rows = make_rows(
        {"phase": Phase.WAITING, "direction": 1},
        {"phase": Phase.ENGAGED, "direction": -1},
        {"phase": Phase.ABORTING, "direction": 1},
        {"phase": Phase.ABORTING, "direction": -1},
    )
    assert indicated_side(rows).tolist() == [1, -1, -1, 1]


def test_nothing_is_indicated_once_the_command_has_ended():
    ended = {"phase": Phase.ABSENT, "direction": 1}
    rows = make_rows(*({**ended, "outcome": outcome} for outcome in list(Outcome)[1:]))
    assert indicated_side(rows).tolist() == [0] * (len(Outcome) - 1)
    assert is_commanded(rows).all()


def test_others_indicate_where_they_move_over():
    rows = make_rows(*({"command": NONE, "moving_over": side} for side in (1, -1, 0)))
    assert indicated_side(rows).tolist() == [1, -1, 0]
    assert not is_commanded(rows).any()


def test_losses_and_brakes():
    rows = make_rows(*({"fate": fate} for fate in Fate))
    assert [Fate(number) for number in is_lost(rows).nonzero()[0]] == [Fate.COLLIDES, Fate.STRAYS]
    rows = make_rows({"acceleration": BRAKE_LIGHT + 0.01}, {"acceleration": BRAKE_LIGHT - 0.01})
    assert is_braking(rows).tolist() == [False, True]
