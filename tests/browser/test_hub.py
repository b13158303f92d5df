"""Viewers of one stream: what a late, a slow and a gone one get."""

import asyncio
import json

import pytest

from marl_lanes.browser.hub import Hub, TooManyViewersError, make_event


def read(viewer):
    """Everything that waits for a viewer, as events: (name, data)."""

    async def collect():
        found = b""
        messages = viewer.messages()
        while True:
            try:
                found += await asyncio.wait_for(anext(messages), 0.01)
            except (TimeoutError, StopAsyncIteration):
                return parse(found)

    return asyncio.run(collect())


def parse(stream):
    events = []
    for block in stream.decode().split("\n\n"):
        fields = dict(line.split(": ", 1) for line in block.splitlines())
        if "event" in fields:
            events.append((fields["event"], json.loads(fields["data"])))
    return events


def test_an_event_is_one_line_of_data():
    event = make_event("status", {"text": "two\nlines: <script>"})
    assert event.endswith(b"\n\n")
    assert event.count(b"\n") == 3
    assert parse(event) == [("status", {"text": "two\nlines: <script>"})]


def test_a_late_viewer_gets_what_is_kept_and_then_all():
    hub = Hub(kept_seconds=10.0)
    hub.say("old")
    hub.say("new")
    hub.begin("first")
    hub.append(1.0, "of the first episode")
    hub.begin("second")
    for time in range(31):
        hub.append(float(time), time)
    viewer = hub.join()
    hub.append(31.0, 31)
    kept = [("rows", time) for time in range(20, 32)]
    assert read(viewer) == [("status", "new"), ("episode", "second"), *kept]


def test_all_viewers_get_the_same():
    hub = Hub()
    viewers = [hub.join() for _ in range(3)]
    hub.say("status")
    hub.begin("episode")
    hub.append(0.0, "rows")
    assert hub.num_viewers == 3
    expected = [("status", "status"), ("episode", "episode"), ("rows", "rows")]
    assert [read(viewer) for viewer in viewers] == [expected] * 3


def test_a_slow_viewer_is_dropped_and_the_others_stay():
    hub = Hub(max_waiting=5)
    slow, quick = hub.join(), hub.join()
    quick_reader = quick.messages()

    async def watch():
        await anext(quick_reader)
        for number in range(20):
            hub.append(0.0, number)
            assert json.loads((await anext(quick_reader)).split(b"data: ")[1]) == number
        assert hub.num_viewers == 1
        # The slow one has ended, and what waited for it is gone.
        past, *rest = [message async for message in slow.messages()]
        assert b"event" not in past
        assert rest == []

    asyncio.run(watch())


def test_there_is_a_largest_number_of_viewers():
    hub = Hub(max_viewers=2)
    first, _ = hub.join(), hub.join()
    with pytest.raises(TooManyViewersError):
        hub.join()
    hub.leave(first)
    hub.leave(first)
    hub.join()


def test_one_waits_until_someone_watches():
    async def watch():
        hub = Hub()
        waiting = asyncio.create_task(hub.wait_for_viewer())
        await asyncio.sleep(0.01)
        assert not waiting.done()
        first, second = hub.join(), hub.join()
        assert await waiting
        hub.leave(first)
        assert not await hub.wait_for_viewer()
        hub.leave(second)
        with pytest.raises(TimeoutError):
            await asyncio.wait_for(hub.wait_for_viewer(), 0.01)

    asyncio.run(watch())


def test_closing_ends_all_streams_and_those_to_come():
    async def watch():
        hub = Hub()
        viewer = hub.join()
        hub.append(0.0, "waits")
        hub.close()
        assert hub.num_viewers == 0
        for one in (viewer, hub.join()):
            async for message in one.messages():
                assert b"retry" in message

    asyncio.run(watch())
