"""Viewers of one live stream: each gets what is kept, then all that follows.

All of it runs in one event loop. A message is an event of a ``text/event-stream``.
"""

import asyncio
import json
from collections import deque
from collections.abc import AsyncIterator
from typing import Any

MAX_VIEWERS = 32
"""More are refused: each costs the computer that also simulates."""

MAX_WAITING = 100
"""Messages that may wait for a viewer; one that is slower is dropped."""

KEPT_SECONDS = 60.0
"""[s] Of the episode that a late viewer gets."""

_RETRY = b"retry: 1000\n\n"
"""[ms] After which a browser comes back when its stream has ended."""


def make_event(name: str, data: Any) -> bytes:
    """An event with JSON as its data."""
    return f"event: {name}\ndata: {json.dumps(data, allow_nan=False)}\n\n".encode()


class TooManyViewersError(Exception):
    """As many as there may be are watching."""


class Viewer:
    """One browser's stream.

    Args:
        past: what it gets first.
        max_waiting: messages that may wait for it.
    """

    def __init__(self, past: bytes, max_waiting: int) -> None:
        self._past = past
        # One more place, for the end.
        self._waiting: asyncio.Queue[bytes | None] = asyncio.Queue(max_waiting + 1)
        self._max_waiting = max_waiting

    @property
    def is_behind(self) -> bool:
        """Whether it has not taken as much as may wait for it."""
        return self._waiting.qsize() >= self._max_waiting

    def send(self, message: bytes) -> None:
        """Let it have a message; it must not be behind."""
        self._waiting.put_nowait(message)

    def end(self) -> None:
        """End the stream; what still waits is forgotten."""
        while not self._waiting.empty():
            self._waiting.get_nowait()
        self._waiting.put_nowait(None)

    async def messages(self) -> AsyncIterator[bytes]:
        """What it gets, until it is dropped or the hub closes."""
        yield self._past
        self._past = b""
        while (message := await self._waiting.get()) is not None:
            yield message


class Hub:
    """Gives every viewer the same messages, and remembers what a late one needs.

    Args:
        max_viewers: more are refused.
        max_waiting: messages that may wait for a viewer. One that is slower is dropped: its browser
            comes back after a second, to the present.
        kept_seconds: of the episode that is remembered [s].
    """

    def __init__(
        self,
        *,
        max_viewers: int = MAX_VIEWERS,
        max_waiting: int = MAX_WAITING,
        kept_seconds: float = KEPT_SECONDS,
    ) -> None:
        self.max_viewers = max_viewers
        self.max_waiting = max_waiting
        self.kept_seconds = kept_seconds
        self._viewers: set[Viewer] = set()
        self._is_watched = asyncio.Event()
        self._is_closed = False
        self._status = b""
        self._episode = b""
        self._kept: deque[tuple[float, bytes]] = deque()

    @property
    def num_viewers(self) -> int:
        """How many are watching."""
        return len(self._viewers)

    async def wait_for_viewer(self) -> bool:
        """Wait until someone is watching; whether that took any time."""
        has_waited = not self._is_watched.is_set()
        await self._is_watched.wait()
        return has_waited

    def join(self) -> Viewer:
        """A new viewer.

        Raises:
            TooManyViewersError: there are as many as there may be.
        """
        if len(self._viewers) >= self.max_viewers:
            raise TooManyViewersError
        kept = [message for _, message in self._kept]
        past = b"".join([_RETRY, self._status, self._episode, *kept])
        viewer = Viewer(past, self.max_waiting)
        if self._is_closed:
            viewer.end()
        else:
            self._viewers.add(viewer)
            self._is_watched.set()
        return viewer

    def leave(self, viewer: Viewer) -> None:
        """Forget a viewer, which may be gone already."""
        self._viewers.discard(viewer)
        if not self._viewers:
            self._is_watched.clear()

    def say(self, status: Any) -> None:
        """Tell a status, which takes the place of the one before."""
        self._status = make_event("status", status)
        self._send(self._status)

    def begin(self, episode: Any) -> None:
        """Begin an episode; the one before is forgotten."""
        self._kept.clear()
        self._episode = make_event("episode", episode)
        self._send(self._episode)

    def append(self, time: float, rows: Any) -> None:
        """Add rows of the episode.

        Args:
            time: of the newest of them, since the episode began [s].
            rows: JSON.
        """
        message = make_event("rows", rows)
        self._kept.append((time, message))
        while self._kept[0][0] < time - self.kept_seconds:
            self._kept.popleft()
        self._send(message)

    def close(self) -> None:
        """End all streams."""
        self._is_closed = True
        for viewer in list(self._viewers):
            viewer.end()
            self.leave(viewer)

    def _send(self, message: bytes) -> None:
        for viewer in list(self._viewers):
            if viewer.is_behind:
                viewer.end()
                self.leave(viewer)
            else:
                viewer.send(message)
