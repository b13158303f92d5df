"""The live server: routes, who may ask, viewers that come and go, the end."""

import itertools
import re
import socket
import time
from contextlib import ExitStack

import pytest
from browser.serving import TIMEOUT, serving

from marl_lanes import FollowerError, load_scenario, register_follower
from marl_lanes.browser.hub import Hub
from marl_lanes.browser.models import Model
from marl_lanes.browser.server import HOST, PAGE, make_index, open_socket
from marl_lanes.evaluation.policies import make_tuned_cascade_policy

PAPER = load_scenario("paper")
CASCADE = Model("tuned-cascade", make_tuned_cascade_policy(PAPER))


@pytest.fixture(scope="module")
def server():
    with serving(CASCADE, PAPER, hub=Hub(max_viewers=3), speed=10.0) as running:
        yield running


def wait_until(condition):
    end = time.monotonic() + TIMEOUT
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.02)


def test_the_page_loads_only_files_that_are_there(server):
    status, headers, page = server.request("/")
    assert status == 200
    assert headers["Content-Type"] == "text/html; charset=utf-8"
    files = re.findall(r'"(/page/\w+\.js)"', page)
    assert len(files) > 10
    assert "/page/live.js" in files
    for file in files:
        status, headers, source = server.request(file)
        assert (status, source) == (200, (PAGE / file.rpartition("/")[2]).read_text("utf-8"))
        assert headers["Content-Type"].startswith("text/javascript")
    # Every address in the page is one of its own.
    assert re.findall(r'(?:src|href)="', page) == []


def test_the_page_may_ask_only_its_server():
    page = make_index(PAPER)
    policy = re.search(r'Content-Security-Policy" content="([^"]*)"', page)[1]
    assert "default-src &#x27;none&#x27;" in policy
    assert "connect-src &#x27;self&#x27;" in policy
    assert "unsafe" not in policy


@pytest.mark.parametrize("path", ["/", "/page/clock.js", "/stream"])
def test_every_answer_says_how_it_may_be_used(server, path):
    status, headers, _ = server.request(path, method="HEAD")
    assert status == 200
    assert headers["Cache-Control"] == "no-cache"
    assert headers["X-Content-Type-Options"] == "nosniff"
    assert headers["Cross-Origin-Resource-Policy"] == "same-origin"
    assert "Access-Control-Allow-Origin" not in headers
    framed = headers.get("Content-Security-Policy")
    assert framed == ("frame-ancestors 'none'" if path == "/" else None)


@pytest.mark.parametrize(
    "path",
    ["/page/../server.py", "/page/%2e%2e/server.py", "/page/..%2fserver.py", "/page//etc/passwd"],
)
def test_only_the_files_of_the_page_are_served(server, path):
    assert server.request(path)[0] == 404


@pytest.mark.parametrize("path", ["/page/", "/page/nothing.js", "/favicon.ico", "/docs"])
def test_what_is_not_there_is_not_found(server, path):
    assert server.request(path)[0] == 404


@pytest.mark.parametrize("path", ["/", "/stream", "/page/clock.js"])
def test_nothing_can_be_sent(server, path):
    assert server.request(path, method="POST")[0] == 405


@pytest.mark.parametrize("path", ["/", "/stream", "/page/clock.js"])
def test_another_name_is_refused(server, path):
    """A foreign site's name that leads here (DNS rebinding) would make this page its own."""
    for name in ("evil.example", "127.0.0.1.evil.example", "localhost.evil.example:80"):
        assert server.request(path, Host=name)[0] == 400
    for name in ("localhost", f"127.0.0.1:{server.port}"):
        assert server.request(path, method="HEAD", Host=name)[0] == 200


@pytest.mark.parametrize("site", ["cross-site", "same-site"])
def test_other_sites_cannot_take_the_stream(server, site):
    assert server.request("/stream", Sec_Fetch_Site=site)[0] == 403


def test_a_foreign_origin_cannot_take_the_stream(server):
    own = f"http://127.0.0.1:{server.port}"
    assert server.request("/stream", method="HEAD", Origin=own)[0] == 200
    for origin in ("http://evil.example", "null", "https" + own[4:], own + "0", f"{own}@evil"):
        assert server.request("/stream", Origin=origin)[0] == 403


HOST_LINE = b"Host: localhost\r\n"
HOSTILE = [
    b"\x00\xff\x16\x03\x01 hello\r\n\r\n",
    b"GET / HTTP/1.1\r\n\r\n",
    b"GET / HTTP/1.0\r\n\r\n",
    b"GET / HTTP/1.1\r\nHost: evil.example\r\n\r\n",
    b"GET / HTTP/1.1\r\nHost: evil.example\r\nHost: localhost\r\n\r\n",
    b"GET / HTTP/1.1\r\nHost: localhost@evil.example\r\n\r\n",
    b"GET http://evil.example/ HTTP/1.1\r\nHost: evil.example\r\n\r\n",
    b"GET / HTTP/1.1\r\n" + HOST_LINE + b"X: " + b"x" * 200_000 + b"\r\n\r\n",
    b"GET /" + b"x" * 200_000 + b" HTTP/1.1\r\n" + HOST_LINE + b"\r\n",
    b"GET /page/%2e%2e/server.py HTTP/1.1\r\n" + HOST_LINE + b"\r\n",
    b"GET /page/..%5cserver.py HTTP/1.1\r\n" + HOST_LINE + b"\r\n",
    b"GET /page/%00 HTTP/1.1\r\n" + HOST_LINE + b"\r\n",
    b"GET /page/" + b"%2e%2e%2f" * 12 + b"etc/passwd HTTP/1.1\r\n" + HOST_LINE + b"\r\n",
    b"GET /../../../../etc/passwd HTTP/1.1\r\n" + HOST_LINE + b"\r\n",
    b"GET /page/ HTTP/1.1\r\n" + HOST_LINE + b"\r\n",
    b"POST /stream HTTP/1.1\r\n" + HOST_LINE + b"Content-Length: 99999999999\r\n\r\nx",
    b"POST / HTTP/1.1\r\n" + HOST_LINE + b"Transfer-Encoding: chunked\r\n\r\nffffffff\r\nx",
    b"POST / HTTP/1.1\r\n" + HOST_LINE + b"Content-Length: 3\r\nContent-Length: 4\r\n\r\nabcd",
    b"DELETE /page/live.js HTTP/1.1\r\n" + HOST_LINE + b"\r\n",
    b"CONNECT evil.example:80 HTTP/1.1\r\nHost: evil.example:80\r\n\r\n",
    b"OPTIONS /stream HTTP/1.1\r\n" + HOST_LINE + b"Origin: http://evil.example\r\n\r\n",
]


@pytest.mark.parametrize("request_bytes", HOSTILE, ids=lambda one: repr(one[:40]))
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_a_hostile_request_gets_no_more_than_an_error(server, request_bytes):
    with socket.create_connection((HOST, server.port), TIMEOUT) as connection:
        connection.sendall(request_bytes)
        answer = connection.recv(65536)
    status = int(answer.split(b" ", 2)[1])
    assert 400 <= status < 500
    assert b"root:" not in answer
    assert b"import " not in answer
    assert b"Access-Control-Allow" not in answer
    assert server.request("/page/clock.js")[0] == 200


def test_a_web_socket_is_not_opened(server):
    headers = {"Upgrade": "websocket", "Connection": "Upgrade", "Sec_WebSocket_Version": "13"}
    assert server.request("/", Sec_WebSocket_Key="AAAAAAAAAAAAAAAAAAAAAA==", **headers)[0] == 200
    assert server.request("/nothing", **headers)[0] == 404


def test_many_idle_connections_leave_room(server):
    """Connections that never ask for anything hold up nobody."""
    with ExitStack() as stack:
        for _ in range(100):
            idle = socket.create_connection((HOST, server.port), TIMEOUT)
            stack.enter_context(idle).sendall(b"GET / HT")
        assert server.request("/page/clock.js")[0] == 200


def test_two_viewers_see_the_same_simulation(server):
    with server.watch() as one, server.watch() as other:
        first, second = (list(itertools.islice(events, 8)) for events in (one, other))
    for events in (first, second):
        assert [kind for kind, _ in events[:3]] == ["status", "episode", "rows"]
        assert events[0][1] == {"waiting": None, "trouble": None}
        assert events[1][1]["header"]["policy"] == "tuned-cascade"
        assert events[1][1]["speed"] == 10.0
    assert first[1] == second[1]
    rows = [
        {data["first_step"]: data for kind, data in one if kind == "rows"}
        for one in (first, second)
    ]
    shared = rows[0].keys() & rows[1].keys()
    assert shared
    assert all(rows[0][step] == rows[1][step] for step in shared)


def test_one_that_goes_leaves_the_others(server):
    with server.watch() as stays:
        with server.watch() as goes:
            next(goes)
            wait_until(lambda: server.server.hub.num_viewers == 2)
        wait_until(lambda: server.server.hub.num_viewers == 1)
        steps = [data["last_step"] for kind, data in itertools.islice(stays, 6) if kind == "rows"]
        assert steps == sorted(set(steps))
    wait_until(lambda: server.server.hub.num_viewers == 0)


def test_there_is_a_largest_number_of_viewers(server):
    with server.watch() as one, server.watch() as two, server.watch() as three:
        for events in (one, two, three):
            next(events)
        status, _, reason = server.request("/stream")
        assert (status, reason) == (503, "3 are watching already")
    wait_until(lambda: server.server.hub.num_viewers == 0)
    with server.watch() as again:
        assert next(again)[0] == "status"


def connect_and_sleep(port):
    """A viewer that reads nothing."""
    stuck = socket.socket()
    stuck.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    stuck.settimeout(TIMEOUT)
    stuck.connect((HOST, port))
    stuck.sendall(b"GET /stream HTTP/1.1\r\nHost: localhost\r\n\r\n")
    return stuck


@pytest.mark.slow
@pytest.mark.parametrize("max_waiting", [3, 100_000])
def test_one_that_does_not_read_holds_neither_the_others_nor_the_end(max_waiting):
    hub = Hub(max_waiting=max_waiting)
    with serving(CASCADE, PAPER, hub=hub) as running, connect_and_sleep(running.port):
        wait_until(lambda: hub.num_viewers == 1)
        # More than the system holds for it.
        for _ in range(100):
            running.call(hub.append, 0.0, "x" * 100_000)
        wait_until(lambda: hub.num_viewers == (0 if max_waiting == 3 else 1))
        with running.watch() as events:
            assert any(kind == "episode" for kind, _ in events)
            begun = time.monotonic()
            running.end()
            # It takes half a second; the limit leaves room for a busy computer.
            assert time.monotonic() - begun < 3.0
            assert running.error is None


@pytest.mark.slow
def test_many_viewers_at_once():
    hub = Hub()
    with serving(CASCADE, PAPER, hub=hub, speed=20.0) as running, ExitStack() as stack:
        streams = [stack.enter_context(running.watch()) for _ in range(hub.max_viewers)]
        last = [list(itertools.islice(events, 5))[-1] for events in streams]
        assert [kind for kind, _ in last] == ["rows"] * hub.max_viewers
        assert running.request("/page/live.js")[0] == 200


def fail(_):
    raise RuntimeError("never")


@pytest.mark.slow
def test_a_follower_that_fails_ends_the_server():
    register_follower("failing", fail)
    scenario = load_scenario("interactive", {"followers": {"mix": {"failing": 1.0}}})
    cascade = Model("tuned-cascade", make_tuned_cascade_policy(scenario))
    with serving(cascade, scenario, speed=20.0) as running:
        with running.watch() as events:
            for _ in events:
                pass
        running.thread.join(TIMEOUT)
        assert isinstance(running.error, RuntimeError | FollowerError)


def test_only_the_loopback_address_is_listened_on():
    with open_socket(0) as listener:
        assert listener.getsockname()[0] == "127.0.0.1"
        port = listener.getsockname()[1]
        with pytest.raises(
            ValueError, match=f"--port {port}: address already in use; choose another"
        ):
            open_socket(port)
    # Free again at once.
    open_socket(port).close()


@pytest.mark.parametrize("port", [-1, 65536])
def test_a_port_out_of_range_is_refused(port):
    with pytest.raises(ValueError, match=f"--port {port}: must be 0 to 65535"):
        open_socket(port)
