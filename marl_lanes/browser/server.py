"""The live server: the page and a running simulation, for browsers of this computer alone."""

import asyncio
import os
import socket
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import uvicorn
from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.middleware.trustedhost import TrustedHostMiddleware
from starlette.requests import Request
from starlette.responses import HTMLResponse, PlainTextResponse, Response, StreamingResponse
from starlette.routing import Mount, Route
from starlette.staticfiles import StaticFiles
from starlette.types import Receive, Scope, Send

from marl_lanes.browser.bundle import make_page, needed_modules
from marl_lanes.browser.episodes import Show
from marl_lanes.browser.hub import Hub, TooManyViewersError, Viewer
from marl_lanes.scenario import Scenario

HOST = "127.0.0.1"
"""The only address that is listened on."""

PAGE = Path(__file__).with_name("page")
"""The page's style and modules."""

ENTRY = "live"
"""The module that starts a page which shows a stream."""

_NAMES = ("127.0.0.1", "localhost")
"""What a browser may call the server. Any other name that leads here is a foreign site's."""

_HEADERS = {
    "Cache-Control": "no-cache",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}

_MAX_HEAD = 16 * 1024
"""[bytes] Of a request before its body, which is never read."""

_MAX_CONNECTIONS = 256
"""More get the status 503; a browser opens a few."""

_SECONDS_TO_LEAVE = 0.3
"""[s] At the end, after which connections are cut."""


def open_socket(port: int) -> socket.socket:
    """A socket that listens on the loopback address.

    Args:
        port: 0 for any free one.

    Raises:
        ValueError: the port is out of range, or cannot be had.
    """
    if not 0 <= port <= 65535:
        raise ValueError(f"--port {port}: must be 0 to 65535")
    listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    try:
        if os.name == "posix":
            # A port whose last connections are closing can be had again. On Windows it can without
            # this, with which two servers could have one port.
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind((HOST, port))
        listener.listen()
    except OSError as error:
        listener.close()
        reason = str(error.strerror).lower()
        raise ValueError(f"--port {port}: {reason}; choose another, or 0 for a free one") from None
    return listener


def make_index(scenario: Scenario) -> str:
    """The page for a stream, HTML; its modules are files of this server."""
    return make_page(
        title=f"{scenario.name}: live",
        entry=ENTRY,
        addresses={name: f"/page/{name}.js" for name in needed_modules(ENTRY)},
        data={},
        sources=["'self'"],
    )


class _Stream(StreamingResponse):
    """What a viewer gets, until it goes or is dropped."""

    def __init__(self, hub: Hub, viewer: Viewer) -> None:
        super().__init__(viewer.messages(), headers=_HEADERS, media_type="text/event-stream")
        self.hub = hub
        self.viewer = viewer

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        try:
            await super().__call__(scope, receive, send)
        finally:
            self.hub.leave(self.viewer)


class _Files(StaticFiles):
    """The page's files."""

    def lookup_path(self, path: str) -> tuple[str, os.stat_result | None]:
        try:
            return super().lookup_path(path)
        except ValueError:  # a null byte: Starlette before 1.0 answers that it has failed
            return "", None

    def file_response(self, *arguments: object, **options: object) -> Response:
        response = super().file_response(*arguments, **options)  # type: ignore[arg-type]
        response.headers.update(_HEADERS)
        return response


def make_app(hub: Hub, index: str) -> Starlette:
    """The server's routes: the page, its files, and the stream.

    Args:
        hub: the viewers of the stream.
        index: the page, HTML.
    """

    async def show_page(_: Request) -> Response:
        # The page's own policy, in its head, cannot say this.
        headers = {"Content-Security-Policy": "frame-ancestors 'none'", **_HEADERS}
        return HTMLResponse(index, headers=headers)

    async def stream(request: Request) -> Response:
        # Another site's page cannot read the stream, but could take the places of viewers.
        own = f"http://{request.headers['host']}"
        is_own = request.headers.get("origin", own) == own
        site = request.headers.get("sec-fetch-site", "same-origin")
        if not is_own or site not in ("same-origin", "none"):
            return PlainTextResponse("only for the page of this server", 403, _HEADERS)
        if request.method == "HEAD":
            return Response(headers=_HEADERS, media_type="text/event-stream")
        try:
            viewer = hub.join()
        except TooManyViewersError:
            return PlainTextResponse(f"{hub.max_viewers} are watching already", 503, _HEADERS)
        return _Stream(hub, viewer)

    return Starlette(
        routes=[
            Route("/", show_page),
            Route("/stream", stream),
            Mount("/page", _Files(directory=PAGE)),
        ],
        middleware=[Middleware(TrustedHostMiddleware, allowed_hosts=_NAMES)],
    )


class LiveServer(uvicorn.Server):
    """Serves the page and drives the show, until ``should_exit`` is set, as by Ctrl-C.

    Args:
        show: what is driven.
        hub: its viewers.
        begin: called when browsers can connect.
    """

    def __init__(self, show: Show, hub: Hub, *, begin: Callable[[], object]) -> None:
        super().__init__(
            uvicorn.Config(
                make_app(hub, make_index(show.scenario)),
                log_level="warning",
                access_log=False,
                server_header=False,
                lifespan="off",
                http="h11",
                h11_max_incomplete_event_size=_MAX_HEAD,
                limit_concurrency=_MAX_CONNECTIONS,
                ws="none",
                loop="asyncio",
            )
        )
        self.show = show
        self.hub = hub
        self._begin = begin

    async def run_on(self, listener: socket.socket) -> None:
        """Serve until the end.

        Args:
            listener: from ``open_socket``; it is closed at the end.

        Raises:
            FollowerError: a follower's policy has failed; the server has ended.
        """
        driving = asyncio.create_task(self.show.run(self.hub))
        driving.add_done_callback(lambda _: self._end())
        try:
            await self.serve(sockets=[listener])
        finally:
            driving.cancel()
        with suppress(asyncio.CancelledError):
            await driving

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Listen; Ctrl-C ends the server already."""
        await super().startup(sockets)
        self._begin()

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """End the streams, which would never end by themselves, then all else."""
        self.hub.close()
        asyncio.get_running_loop().call_later(_SECONDS_TO_LEAVE, self._cut)
        await super().shutdown(sockets)

    def _end(self) -> None:
        self.should_exit = True

    def _cut(self) -> None:
        """Cut the connections of browsers that do not take what they are sent."""
        for connection in list(self.server_state.connections):
            connection.transport.abort()
