"""One simulation for all viewers: what they get, when, and of which model."""

import asyncio
import json

import numpy as np
import pytest
from recordings import record

from marl_lanes import ScenarioError, Simulator, load_scenario
from marl_lanes.browser import episodes
from marl_lanes.browser.encoding import encode_chunk, encode_header
from marl_lanes.browser.episodes import MAX_EPISODE, Episode, Show
from marl_lanes.browser.hub import Hub
from marl_lanes.browser.models import FixedModel, Model
from marl_lanes.evaluation.policies import make_tuned_cascade_policy
from marl_lanes.traffic.machine.state import Fate, Outcome
from marl_lanes.trajectory.columns import new_rows
from marl_lanes.trajectory.events import find_events

BUSY = load_scenario(
    "paper",
    {
        "num_agents": 4,
        "horizon": 60.0,
        "warmup": [20.0, 30.0],
        "departures": {"interval": [1.5, 3.0]},
        "command": {"probability": 1.0},
    },
)
CASCADE = Model("tuned-cascade", make_tuned_cascade_policy(BUSY))


def test_an_episode_is_that_of_a_recording():
    """The same rows, and the same events as if all rows were known."""
    episode = Episode(BUSY, CASCADE, 5, {})
    chunks = [episode.read(), *(episode.drive(7) for _ in range(30))]
    recorded = record(BUSY, 210, seed=5)
    rows = recorded.rows_of(0)
    assert episode.header == encode_header(recorded.metadata, 0)
    assert episode.time == pytest.approx(21.0)
    events = [event for chunk in chunks for event in chunk.pop("events")]
    assert events == [list(event) for event in find_events(rows)]
    assert {event[1] for event in events} > {"command", "engaged", "completed"}
    for chunk in chunks:
        steps = (rows["step"] >= chunk["first_step"]) & (rows["step"] <= chunk["last_step"])
        expected = encode_chunk(rows[steps], [])
        assert chunk | {"events": []} == expected
    assert [chunk["last_step"] for chunk in chunks] == list(range(0, 211, 7))


def test_an_event_names_the_command_that_a_vehicle_had_long_before(monkeypatch):
    rows = new_rows(6)
    rows["step"], rows["vehicle"] = np.arange(6), 7
    rows["command"][1:3] = 4
    rows["outcome"][2] = Outcome.COMPLETED
    rows["fate"][5], rows["collided_with"][5] = Fate.COLLIDES, 8
    frames = iter(np.split(rows, 6))
    monkeypatch.setattr(episodes.FrameReader, "read", lambda _: next(frames))
    episode = Episode(BUSY, CASCADE, 0, {})
    chunks = [episode.read(), *(episode.drive(1) for _ in range(5))]
    events = [event for chunk in chunks for event in chunk["events"]]
    assert events == [list(event) for event in find_events(rows)]
    assert events[-1] == [5, "collision", 7, 4, 8]


def test_an_episode_ends_some_seconds_after_its_last_command():
    episode = Episode(BUSY, CASCADE, 0, {})
    last = 0
    while not episode.is_over:
        chunk = episode.drive(10)
        last = max([last, *(event[0] for event in chunk["events"])])
    assert 5.0 <= episode.time - last * BUSY.time_step < 6.1
    assert episode.drive(10) is None


def test_an_endless_episode_ends_all_the_same(monkeypatch):
    assert MAX_EPISODE == 600.0
    monkeypatch.setattr(episodes, "MAX_EPISODE", 20.0)
    scenario = load_scenario(BUSY, {"num_agents": None, "horizon": None})
    episode = Episode(scenario, CASCADE, 0, {})
    chunk = episode.drive(10**6)
    assert episode.is_over
    assert episode.time == pytest.approx(20.0)
    assert chunk["last_step"] == 200


def test_a_road_without_vehicles_has_no_chunk():
    scenario = load_scenario(
        BUSY, {"departures": {"interval": [1000.0, 1000.0]}, "warmup": [0.0, 0.0]}
    )
    episode = Episode(scenario, CASCADE, 0, {})
    assert episode.read() is None
    assert episode.drive(3) is None


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"seed": -1}, r"seed = -1: must be 0 to 2\^64 - 1"),
        ({"seed": 2**64}, "seed = 18446744073709551616: must be"),
        ({"speed": 0.0}, r"speed = 0\.0: must be 0\.1 to 20"),
        ({"speed": 20.5}, r"speed = 20\.5: must be 0\.1 to 20"),
        ({"speed": float("nan")}, "speed = nan: must be"),
    ],
)
def test_numbers_out_of_range_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        Show(BUSY, FixedModel(CASCADE), **options)


def test_a_follower_without_a_policy_is_refused_before_anyone_watches():
    scenario = load_scenario(BUSY, {"followers": {"mix": {"stranger": 1.0}}})
    with pytest.raises(ScenarioError, match="stranger"):
        Show(scenario, FixedModel(CASCADE)).prepare()
    Show(BUSY, FixedModel(CASCADE)).prepare()


class Hearing(Hub):
    """A hub that remembers everything, with the time."""

    def __init__(self):
        super().__init__()
        self.heard = []

    def _send(self, message):
        clock = asyncio.get_running_loop().time
        name, data = message.decode().split("\n")[:2]
        self.heard.append(
            (clock(), name.removeprefix("event: "), json.loads(data.removeprefix("data: ")))
        )
        super()._send(message)

    def of(self, kind):
        return [data for _, name, data in self.heard if name == kind]


async def run_for(seconds, show, hub, then=None):
    """Run the show with a viewer."""
    viewer = hub.join()

    async def take():
        async for _ in viewer.messages():
            pass

    tasks = [asyncio.create_task(take()), asyncio.create_task(show.run(hub))]
    await asyncio.sleep(seconds)
    if then is not None:
        await then(viewer)
    for task in tasks:
        task.cancel()
    results = await asyncio.gather(*tasks, return_exceptions=True)
    assert all(isinstance(one, asyncio.CancelledError) for one in results), results


@pytest.mark.slow
@pytest.mark.parametrize("speed", [1.0, 5.0])
def test_it_keeps_the_pace_of_the_clock(speed):
    hub, show = Hearing(), Show(BUSY, FixedModel(CASCADE), speed=speed)
    show.prepare()
    asyncio.run(run_for(2.2, show, hub))
    rows = [(time, data["last_step"]) for time, name, data in hub.heard if name == "rows"]
    (first, _), *_, (last, step) = rows
    assert step * BUSY.time_step == pytest.approx(speed * (last - first), rel=0.1)
    assert len(rows) >= 4
    # None comes before its time.
    assert all(
        number * BUSY.time_step <= speed * (time - first) + 0.01 * speed for time, number in rows
    )


@pytest.mark.slow
def test_nothing_is_simulated_while_nobody_watches(monkeypatch):
    steps = []
    step = Simulator.step
    monkeypatch.setattr(Simulator, "step", lambda *given: (steps.append(0), step(*given))[1])
    hub, show = Hearing(), Show(BUSY, FixedModel(CASCADE), speed=10.0)

    async def leave_and_come_back(viewer):
        hub.leave(viewer)
        await asyncio.sleep(0.7)
        before = len(steps)
        assert before > 0
        await asyncio.sleep(1.0)
        assert len(steps) == before
        viewer = hub.join()
        await asyncio.sleep(0.7)
        # It goes on from there, at its pace: what was missed is not caught up.
        assert before < len(steps) <= before + 150

    asyncio.run(run_for(1.0, show, hub, leave_and_come_back))
    starts = [data["first_step"] for data in hub.of("rows")]
    ends = [data["last_step"] for data in hub.of("rows")]
    assert starts[1:] == [end + 1 for end in ends[:-1]]


class Growing:
    """Models that come one after the other."""

    waiting = "nothing yet"
    trouble = "something is broken"

    def __init__(self, answers):
        self.answers = list(answers)

    def find_newest(self):
        return self.answers.pop(0) if len(self.answers) > 1 else self.answers[0]


@pytest.mark.slow
def test_a_newer_model_drives_the_next_episode(monkeypatch):
    monkeypatch.setattr(episodes, "_POLLING", 0.05)
    monkeypatch.setattr(episodes, "MAX_EPISODE", 4.0)
    newer = CASCADE._replace(label="newer")
    models = Growing([None, None, CASCADE, newer])
    hub, show = Hearing(), Show(BUSY, models, seed=2**64 - 1, speed=20.0)
    asyncio.run(run_for(2.0, show, hub))
    status = {"waiting": "nothing yet", "trouble": "something is broken"}
    assert hub.of("status")[:3] == [status, status, status | {"waiting": None}]
    first, second, *_ = hub.of("episode")
    assert [one["header"]["policy"] for one in (first, second)] == ["tuned-cascade", "newer"]
    # Each can be recorded again by its seed; the seeds go round.
    assert [one["header"]["seed"] for one in (first, second)] == [str(2**64 - 1), "0"]
    assert first["name"] != second["name"]
    assert first["speed"] == 20.0
    starts = [data["first_step"] for data in hub.of("rows")]
    assert starts.count(0) >= 2


def test_actions_are_those_of_the_model():
    seen = []

    def policy(observations):
        seen.append(observations.copy())
        return np.zeros((len(observations), 1))

    episode = Episode(BUSY, Model("zeros", policy), 0, {})
    episode.drive(200)
    assert len(seen) > 20
    assert all(one.shape[1] == len(BUSY.observation.features) for one in seen)
