import pytest
from pictures import commanded, make_frame

from marl_lanes.rendering.options import ViewOptions
from marl_lanes.rendering.spotlight import HOLD_TIME, Spotlight
from marl_lanes.traffic.machine.state import Fate, Outcome, Phase

ENDED = {"position": 300.0, "lane": 2, "command": 0, "outcome": Outcome.COMPLETED}


def follow(*frames, **options):
    spotlight = Spotlight(ViewOptions(**options))
    return [spotlight.look(frame).vehicle for frame in frames], spotlight


def test_an_agent_that_steers_comes_before_one_that_waits():
    frame = make_frame(
        {"position": 500.0},
        commanded(300.0, phase=Phase.WAITING, command=0),
        commanded(250.0, phase=Phase.ENGAGED, command=2),
        commanded(200.0, phase=Phase.ABORTING, command=1),
    )
    assert follow(frame)[0] == [3]


def test_an_agent_is_followed_to_its_end_and_a_moment_longer():
    both = make_frame(commanded(300.0, command=0), {"position": 100.0})
    other = make_frame(commanded(310.0, command=0), commanded(110.0, phase=2, command=1), step=1)
    ended = make_frame(ENDED, commanded(120.0, phase=2, command=1), step=2)
    hold = int(HOLD_TIME / 0.1)
    later = [
        make_frame({"position": 330.0, "lane": 2}, commanded(150.0, phase=2, command=1), step=step)
        for step in (3, 1 + hold, 2 + hold)
    ]
    assert follow(both, other, ended, *later)[0] == [0, 0, 0, 0, 0, 1]


def test_without_an_agent_it_is_the_next_one_that_may_get_a_command():
    cars = [{"position": place, "lane": lane} for place, lane in ((139, 0), (160, 1), (90, 1))]
    cars.append({"position": 120.0, "lane": 1})
    frame = make_frame(*cars)
    focus = Spotlight(ViewOptions()).look(frame)
    assert (focus.vehicle, focus.row, focus.position, focus.lane) == (3, 3, 120.0, 1)


def test_a_bystander_is_kept_until_it_is_gone():
    first = make_frame({"position": 120.0, "lane": 1}, {"position": 60.0, "lane": 1})
    later = make_frame({"position": 400.0, "lane": 1}, {"position": 130.0, "lane": 1}, step=100)
    gone = make_frame({"position": 800.0, "lane": 1, "vehicle": 1}, step=400)
    assert follow(first, later, gone)[0] == [0, 0, 1]


def test_an_empty_road_has_no_focus():
    focus = Spotlight(ViewOptions()).look(make_frame())
    assert (focus.vehicle, focus.row, focus.position) == (-1, None, 0.0)


def test_a_named_changer_is_followed_also_after_its_end():
    frames = [
        make_frame(commanded(300.0, phase=2, command=4), {"position": 100.0}),
        make_frame(commanded(310.0, phase=2, command=4), commanded(120.0, command=7), step=1),
        make_frame({"position": 320.0}, {"position": 140.0}, step=2),
        make_frame({"position": 320.0}, {"position": 140.0}, step=90),
    ]
    assert follow(*frames, follow="changer_7")[0] == [0, 1, 1, 1]


def test_a_numbered_vehicle_is_followed_while_it_is_there():
    frames = [
        make_frame(commanded(300.0), {"position": 100.0}),
        make_frame(commanded(310.0), step=1),
    ]
    assert follow(*frames, follow=1)[0] == [1, 0]


@pytest.mark.parametrize(
    ("columns", "outcome"),
    [
        ({"fate": Fate.COLLIDES, "collided_with": 1}, Outcome.COLLISION),
        ({"fate": Fate.STRAYS}, Outcome.OFF_ROAD),
        ({"command": 3, "outcome": Outcome.MISSED, "fate": Fate.LEAVES}, Outcome.MISSED),
        ({"command": 3, "outcome": Outcome.COMPLETED}, Outcome.COMPLETED),
    ],
)
def test_what_has_happened_is_remembered_for_a_moment(columns, outcome):
    frame = make_frame({"position": 200.0, **columns}, {"position": 500.0})
    _, spotlight = follow(frame, frame)
    (incident,) = spotlight.incidents
    assert (incident.outcome, incident.vehicle, incident.position) == (outcome, 0, 200.0)
    assert incident.command == columns.get("command", -1)
    hold = int(HOLD_TIME / 0.1)
    spotlight.look(make_frame({"position": 510.0, "vehicle": 1}, step=hold - 1))
    assert len(spotlight.incidents) == 1
    spotlight.look(make_frame({"position": 510.0, "vehicle": 1}, step=hold))
    assert spotlight.incidents == []


def test_the_camera_stays_where_an_agent_was_lost():
    lost = {"position": 200.0, "command": 0, "outcome": Outcome.COLLISION, "fate": Fate.COLLIDES}
    spotlight = Spotlight(ViewOptions())
    spotlight.look(make_frame(commanded(190.0, phase=2), {"position": 500.0}))
    spotlight.look(make_frame(lost, {"position": 502.0}, step=1))
    focus = spotlight.look(make_frame({"position": 505.0, "vehicle": 1}, step=2))
    assert (focus.vehicle, focus.row, focus.position) == (0, None, 200.0)


def test_another_road_or_an_earlier_step_makes_it_forget():
    lost = {"position": 200.0, "fate": Fate.STRAYS}
    for again in ({"road": 1, "step": 6}, {"road": 0, "step": 4}):
        _, spotlight = follow(make_frame(lost, step=5))
        assert len(spotlight.incidents) == 1
        focus = spotlight.look(make_frame({"position": 50.0, "vehicle": 9}, **again))
        assert spotlight.incidents == []
        assert focus.vehicle == 9
