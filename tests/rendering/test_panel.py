import pytest
from pictures import STRAIGHT, commanded, crop, is_colour, make_frame

from marl_lanes import load_scenario
from marl_lanes.rendering.layout import make_layout
from marl_lanes.rendering.lettering import Lettering
from marl_lanes.rendering.loading import pygame
from marl_lanes.rendering.options import ViewOptions
from marl_lanes.rendering.palette import PHASES, SAFE_GAP, WARNING
from marl_lanes.rendering.panel import Panel
from marl_lanes.rendering.spotlight import Focus, Incident
from marl_lanes.traffic.machine.state import Outcome, Phase

AGENT = commanded(
    300.0,
    direction=-1,
    phase=Phase.ENGAGED,
    command=3,
    target_leader=1,
    target_follower=2,
    lateral_deviation=1.25,
    yaw=-0.05,
    acceleration=-0.04,
    action_yaw_acceleration=-0.25,
    reward=-0.142,
    reward_yaw_acceleration=-0.1,
    reward_yaw_rate=-0.042,
    reward_deviation=0.0,
    reward_failure=0.0,
)
CARS = (AGENT, {"position": 330.0}, {"position": 280.0})


def paint(
    frame,
    row=0,
    *,
    incidents=(),
    scenario=STRAIGHT,
    title="cascade",
    speed=1.0,
    size=(1280, 720),
):
    layout, lettering = make_layout(scenario, ViewOptions(size=size)), Lettering()
    surface = pygame.Surface(size, depth=32)
    panel = Panel(scenario, layout, lettering, title, speed)
    panel.draw_ground(surface)
    vehicle = -1 if row is None else int(frame.rows["vehicle"][row])
    panel.draw(surface, frame, Focus(vehicle, row, 300.0, 1), list(incidents))
    return layout, lettering.texts, pygame.surfarray.array3d(surface).swapaxes(0, 1)


def value_of(texts, name):
    return texts[texts.index(name) + 1]


def test_the_numbers_of_the_followed_agent():
    _, texts, _ = paint(make_frame(*CARS, step=123))
    assert texts[:6] == ["12.3 s", "cascade", "paper", "road 0", "3 vehicles", "1 commanded"]
    assert texts[6:8] == ["engaged", "changer_3"]
    expected = {
        "to the right": "lane 1 to 0",
        "speed": "25.0 m/s, 90 km/h",
        "acceleration": "0.0 m/s²",
        "gap ahead": "25.2 m",
        "gap behind": "15.2 m",
        "deviation": "+1.25 m",
        # Positive to the target, as in the observation.
        "yaw": "+2.9°",
        "steering": "-0.25 rad/s²",
        "yaw acceleration": "-0.100",
        "yaw rate": "-0.042",
        "failure": "0.000",
        "sum": "-0.142",
    }
    assert {name: value_of(texts, name) for name in expected} == expected
    assert texts.count("deviation") == 2
    assert "throttle" not in texts
    assert "delay" not in texts


def test_gaps_are_between_the_bumpers_of_every_size():
    """A truck behind: half of its 16.5 m, and half of the changer's 4.8 m."""
    behind = {"position": 270.0, "lane": 0, "profile": 3}
    agent = commanded(300.0, direction=-1, target_follower=1)
    _, texts, _ = paint(make_frame(agent, behind))
    assert value_of(texts, "gap behind") == "19.4 m"


def test_missing_neighbors_are_free():
    _, texts, _ = paint(make_frame(commanded(300.0)))
    assert value_of(texts, "gap ahead") == value_of(texts, "gap behind") == "free"
    assert value_of(texts, "steering") == "-"


@pytest.mark.parametrize("size", [(640, 360), (800, 450), (1024, 576), (1280, 720), (1920, 1080)])
def test_the_second_action_and_its_terms(size):
    scenario = load_scenario("interactive")
    agent = {**AGENT, "action_acceleration": 1.5, "reward_longitudinal": -0.02}
    layout, texts, _ = paint(make_frame(agent, scenario=scenario), scenario=scenario, size=size)
    assert value_of(texts, "throttle") == "+1.50 m/s²"
    assert ("reward" in layout.panel) == (size[0] > 640)
    if "reward" in layout.panel:
        assert value_of(texts, "longitudinal") == "-0.020"


@pytest.mark.parametrize("phase", [Phase.WAITING, Phase.ENGAGED, Phase.ABORTING])
def test_the_phase_has_its_colour(phase):
    layout, texts, picture = paint(make_frame(commanded(300.0, phase=phase)))
    assert phase.name.lower() in texts
    assert is_colour(crop(picture, layout.panel["agent"]), PHASES[phase], 3).sum() > 300


def bars(**terms):
    layout, _, picture = paint(make_frame({**AGENT, **terms}))
    part = crop(picture, layout.panel["reward"])
    return [is_colour(part, colour, 3) for colour in (WARNING, SAFE_GAP)]


def test_bars_have_the_sign_and_grow_with_the_number():
    zero = dict.fromkeys(("reward", "reward_yaw_acceleration", "reward_yaw_rate"), 0.0)
    negative, positive = bars(**zero)
    assert negative.sum() == positive.sum() == 0
    widths = []
    for value in (-0.01, -0.1, -10.0, 0.1):
        negative, positive = bars(**{**zero, "reward_yaw_rate": value})
        drawn, other = (negative, positive) if value < 0.0 else (positive, negative)
        assert other.sum() == 0
        columns = drawn.any(axis=0).nonzero()[0]
        widths.append((columns[0], columns[-1]))
    (small, middle, large, plus) = widths
    assert small[0] > middle[0] > large[0]
    assert small[1] == middle[1] == large[1] < plus[0]
    assert plus[1] - plus[0] == pytest.approx(middle[1] - middle[0], abs=1)


def test_it_says_that_no_command_is_live():
    _, texts, _ = paint(make_frame({"position": 300.0, "vehicle": 17, "disposition": 2}))
    assert "No command is live" in texts
    assert value_of(texts, "vehicle") == "17"
    assert value_of(texts, "disposition") == "adversarial"
    assert "0 commanded" in texts
    _, texts, _ = paint(make_frame({"position": 300.0}, commanded(100.0)))
    assert "Not commanded" in texts


@pytest.mark.parametrize("row", [0, None])
def test_an_outcome_stays_for_a_moment(row):
    frame = make_frame({"position": 300.0}, step=5)
    incident = Incident(-1 if row is None else 0, 3, Outcome.OFF_ROAD, 0.2, 300.0, 2.0, 4.8, 1.8)
    _, texts, _ = paint(frame, row, incidents=[incident])
    assert texts[texts.index("off road") + 1] == "changer_3"
    assert ("the followed vehicle is gone" in texts) == (row is None)


def test_title_and_speed():
    _, texts, _ = paint(make_frame(*CARS), title="runs/with/a/very/long/name.pt", speed=0.5)
    assert texts[1].endswith("…")
    assert "0.5 x speed" in texts
    _, texts, _ = paint(make_frame(*CARS), title="")
    assert texts[1] == "paper"
