"""A live server in a thread of this process, and clients for it."""

import asyncio
import http.client
import json
import threading
from contextlib import contextmanager

from marl_lanes.browser.episodes import Show
from marl_lanes.browser.hub import Hub
from marl_lanes.browser.models import FixedModel
from marl_lanes.browser.server import LiveServer, open_socket

TIMEOUT = 20.0
"""[s] Nothing that is waited for takes longer."""


class Serving:
    """A server that runs."""

    def __init__(self, server, port):
        self.server = server
        self.port = port
        self.error = None
        self.loop = None
        self.thread = None

    @property
    def address(self):
        return f"http://127.0.0.1:{self.port}/"

    def request(self, path, *, method="GET", **headers):
        """The status, the headers and the body of an answer."""
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=TIMEOUT)
        try:
            names = {name.replace("_", "-"): value for name, value in headers.items()}
            connection.request(method, path, headers=names)
            response = connection.getresponse()
            return response.status, response.headers, response.read().decode()
        finally:
            connection.close()

    def call(self, function, *arguments):
        """Let the server's thread call a function."""
        self.loop.call_soon_threadsafe(function, *arguments)

    def end(self):
        """As Ctrl-C does."""
        self.server.should_exit = True
        self.thread.join(TIMEOUT)
        assert not self.thread.is_alive()

    @contextmanager
    def watch(self):
        """An iterator over the events of a stream: (name, data)."""
        with listen(self.port) as events:
            yield events


@contextmanager
def listen(port):
    """An iterator over the events of a stream: (name, data)."""
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=TIMEOUT)
    connection.request("GET", "/stream")
    response = connection.getresponse()
    assert response.status == 200, response.status
    try:
        yield read_events(response)
    finally:
        response.close()
        connection.close()


def read_events(response):
    name = None
    for line in response:
        field, _, value = line.decode().rstrip("\n").partition(": ")
        if field == "event":
            name = value
        elif field == "data":
            yield name, json.loads(value)


@contextmanager
def serving(models, scenario, *, hub=None, port=0, speed=1.0, seed=0):
    """Run a server, and end it."""
    if not hasattr(models, "find_newest"):
        models = FixedModel(models)
    show = Show(scenario, models, speed=speed, seed=seed)
    show.prepare()
    listener = open_socket(port)
    has_begun = threading.Event()
    server = LiveServer(show, hub or Hub(), begin=has_begun.set)
    found = Serving(server, listener.getsockname()[1])

    async def run():
        found.loop = asyncio.get_running_loop()
        await server.run_on(listener)

    def run_and_note():
        try:
            asyncio.run(run())
        except Exception as error:
            found.error = error

    found.thread = threading.Thread(target=run_and_note)
    found.thread.start()
    try:
        assert has_begun.wait(TIMEOUT)
        yield found
    finally:
        found.end()
        listener.close()
