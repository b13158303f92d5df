"""The page of a running simulation in a browser: the newest, the past, what it says."""

import time
from itertools import pairwise

import pytest
from browser.serving import serving
from browser.waiting import wait_until
from recordings import record

from marl_lanes import load_scenario
from marl_lanes.browser import episodes
from marl_lanes.browser.models import Model
from marl_lanes.colours import TRAFFIC
from marl_lanes.evaluation.policies import make_tuned_cascade_policy

pytestmark = pytest.mark.slow

BUSY = load_scenario(
    "paper",
    {
        "name": "<b>busy</b>",
        "num_agents": 30,
        "warmup": [20.0, 30.0],
        "departures": {"interval": [1.5, 3.0]},
        "command": {"probability": 1.0},
    },
)
HOSTILE = "<img src=x onerror=alert(1)>"
CASCADE = Model(HOSTILE, make_tuned_cascade_policy(BUSY))

NEAR = "live.isFollowing && player.clock.isPlaying && live.lag < 2 * live.episode.speed"
COLOURS = """() => {
    const context = player.canvas.getContext('2d');
    const { scene, camera } = player;
    const ratio = window.devicePixelRatio;
    const found = [];
    for (let i = 0; i < scene.count; i += 1) {
        const { x, y } = camera.project(scene.position[i], scene.lateral[i], {});
        if (x < 20 || x > camera.width - 120 || y < 40 || y > camera.height - 40) continue;
        const [r, g, b] = context.getImageData(x * ratio, y * ratio, 1, 1).data;
        const colour = '#' + [r, g, b].map((one) => one.toString(16).padStart(2, '0')).join('');
        found.push([scene.value('command', i) >= 0, colour]);
    }
    return found;
}"""
DRAWN = """() => new Promise((done) => {
    requestAnimationFrame(() => requestAnimationFrame(() => done(true)));
})"""


class Appearing:
    """A run that has no model until it is told."""

    waiting = "<b>run</b> has no saved model yet"
    trouble = None
    model = None

    def find_newest(self):
        return self.model


@pytest.fixture
def server():
    with serving(CASCADE, BUSY, seed=4) as running:
        yield running


def text_of(page):
    return page.inner_text("#live-text")


def test_cars_drive_at_the_newest(server, open_page):
    rows = record(BUSY, 100, seed=4).rows_of(0)
    with open_page(server.address) as page:
        wait_until(page, f"{NEAR} && player.clock.time > 1")
        begin = time.monotonic()
        times = [page.evaluate("player.clock.time")]
        for _ in range(4):
            page.wait_for_timeout(400)
            times.append(page.evaluate("player.clock.time"))
            assert page.evaluate(NEAR)
        assert times == sorted(set(times))
        # As long as it took, where the machine was busy, too, but for what the page was behind.
        elapsed = time.monotonic() - begin
        assert 0.4 * elapsed < times[-1] - times[0] < elapsed + 2.0
        assert page.get_attribute("#live-badge", "class") == "on"
        assert not page.is_visible("#to-live")
        # What it shows is what a recording of this seed holds, and what the canvas shows.
        page.keyboard.press(" ")
        page.evaluate("player.clock.seek(Math.floor(player.clock.time / 0.1) * 0.1)")
        page.evaluate(DRAWN)
        step = page.evaluate("player.scene.step")
        shown = page.evaluate("Array.from(player.scene.vehicle)").__iter__()
        count = page.evaluate("player.scene.count")
        vehicles = [next(shown) for _ in range(count)]
        expected = rows[rows["step"] == step]
        assert sorted(vehicles) == sorted(expected["vehicle"].tolist())
        for vehicle, position in zip(
            vehicles, page.evaluate("Array.from(player.scene.position)"), strict=False
        ):
            (row,) = expected[expected["vehicle"] == vehicle]
            assert position == pytest.approx(row["position"], abs=0.01)
        colours = page.evaluate(COLOURS)
        assert colours
        for is_changer, colour in colours:
            assert colour == (TRAFFIC.changer if is_changer else TRAFFIC.vehicle)


def test_names_are_text(server, open_page):
    with open_page(server.address) as page:
        wait_until(page, NEAR)
        assert page.inner_text("#title") == "<b>busy</b>"
        assert HOSTILE in page.inner_text("#subtitle")
        assert page.title() == "<b>busy</b>: live"
        assert page.locator("main img, header img, #live img").count() == 0


def test_one_goes_back_and_returns(server, open_page):
    with open_page(server.address) as page:
        wait_until(page, f"{NEAR} && player.store.lastTime > 5")
        page.keyboard.press("Home")
        page.evaluate(DRAWN)
        assert page.evaluate("player.clock.time") < 2.0
        assert page.get_attribute("#live-badge", "class") == ""
        # It plays from there, while the newest goes on.
        newest = page.evaluate("player.store.lastTime")
        wait_until(page, f"player.clock.time > 1 && player.store.lastTime > {newest + 1}")
        assert not page.evaluate("live.isFollowing")
        page.click("#to-live")
        wait_until(page, NEAR)
        assert not page.is_visible("#to-live")
        page.click("#play")
        wait_until(page, "!player.clock.isPlaying && !live.isFollowing")
        time = page.evaluate("player.clock.time")
        page.wait_for_timeout(700)
        assert page.evaluate("player.clock.time") == time
        assert page.is_visible("#to-live")
        page.keyboard.press("End")
        page.keyboard.press(" ")
        wait_until(page, NEAR)
        page.select_option("#speed", "0.5")
        wait_until(page, "!live.isFollowing")


def test_nothing_changes_while_the_mouse_is_down(server, open_page):
    with open_page(server.address) as page:
        wait_until(page, NEAR)
        page.mouse.move(5, 5)
        page.mouse.down()
        page.wait_for_timeout(300)
        step = page.evaluate("player.store.lastStep")
        page.wait_for_timeout(1200)
        assert page.evaluate("player.store.lastStep") == step
        page.mouse.up()
        wait_until(page, f"player.store.lastStep > {step} + 5")


def test_a_new_episode_waits_for_one_who_looks_at_the_past(open_page, monkeypatch):
    monkeypatch.setattr(episodes, "MAX_EPISODE", 30.0)
    models = Appearing()
    models.model = CASCADE
    with serving(models, BUSY, seed=7, speed=10.0) as running, open_page(running.address) as page:
        wait_until(page, f"{NEAR} && player.header.seed === '7'")
        assert text_of(page) == ""
        models.model = CASCADE._replace(label="newer")
        wait_until(page, "player.header.policy === 'newer'")
        assert text_of(page) == "Now newer drives."
        assert "policy newer" in page.inner_text("#subtitle")
        # Early in an episode: another must not begin between the keys.
        early = "player.store.lastTime > 5 && player.store.lastTime < 15"
        wait_until(page, f"{NEAR} && player.store.firstStep === 0 && {early}")
        page.keyboard.press(" ")
        page.keyboard.press("Home")
        page.evaluate("player.clock.seek(1)")
        seed = page.evaluate("player.header.seed")
        assert f"seed {seed}" in page.inner_text("#subtitle")
        wait_until(page, "live.isPending")
        assert "Another episode has begun." in text_of(page)
        page.wait_for_timeout(4000)
        assert page.evaluate("[player.header.seed, player.clock.time]") == [seed, 1]
        # What waits is bounded: one episode.
        assert page.evaluate("live.queue.filter(([kind]) => kind === 'episode').length") == 1
        page.click("#to-live")
        wait_until(page, f"{NEAR} && player.header.seed > {seed}")
        assert page.evaluate("player.store.lastTime") <= 31.0


RECEIVE_WHILE_DRAINING = """() => {
    live.isDraining = true;
    live.receive('episode', { ...live.episode, name: `${performance.now()}` });
    live.isDraining = false;
    return document.getElementById('live-text').textContent;
}"""


def test_an_episode_that_comes_among_rows_is_said_at_once(server, open_page):
    with open_page(server.address) as page:
        wait_until(page, NEAR)
        page.keyboard.press(" ")
        wait_until(page, "!live.isFollowing")
        assert text_of(page) == ""
        assert page.evaluate(RECEIVE_WHILE_DRAINING) == "Another episode has begun."
        page.click("#to-live")
        wait_until(page, f"{NEAR} && !live.isPending")
        # One who follows sees it in a moment.
        assert page.evaluate(RECEIVE_WHILE_DRAINING) == ""


def collect_faults(page):
    faults = []
    page.on("pageerror", lambda error: faults.append(str(error)))
    return faults


def test_it_waits_for_the_first_model(browser, monkeypatch):
    monkeypatch.setattr(episodes, "_POLLING", 0.1)
    models = Appearing()
    with serving(models, BUSY) as running, browser.new_page() as page:
        faults = collect_faults(page)
        page.goto(running.address)
        wait_until(page, "document.getElementById('live-text').textContent.includes('no saved')")
        assert text_of(page) == "<b>run</b> has no saved model yet."
        assert page.inner_text("#title") == "<b>busy</b>: live"
        assert not page.is_visible("main")
        models.model = CASCADE
        wait_until(page, f"live.player && {NEAR}")
        assert text_of(page) == ""
        assert page.is_visible("#road")
        assert faults == []


def test_trouble_is_said(browser):
    models = Appearing()
    models.model, models.trouble = CASCADE, "passed over: <i>"
    with serving(models, BUSY) as running, browser.new_page() as page:
        page.goto(running.address)
        wait_until(page, "live.player !== null")
        assert text_of(page) == "Passed over: <i>."
        assert page.get_attribute("#live-text", "class") == "warning"


def test_a_lost_connection_comes_back(browser):
    with browser.new_page() as page:
        faults = collect_faults(page)
        with serving(CASCADE, BUSY) as running:
            port = running.port
            page.goto(running.address)
            wait_until(page, f"live.player && {NEAR}")
            first = page.evaluate("live.episode.name")
        wait_until(page, "live.connection === 'lost'")
        assert text_of(page) == "Connection lost; trying again."
        assert page.get_attribute("#live-badge", "class") == ""
        with serving(CASCADE, BUSY, port=port):
            wait_until(page, "live.connection === 'open'")
            assert text_of(page) == "Connected again."
            wait_until(page, f"live.episode.name !== '{first}' && {NEAR}")
            wait_until(page, "live.notice === ''")
            assert text_of(page) == ""
        assert faults == []


def test_a_hidden_page_takes_no_connection_and_goes_on(server, open_page):
    hub = server.server.hub
    with open_page(server.address) as page:
        wait_until(page, f"{NEAR} && player.store.lastStep > 20")
        set_hidden = """(hidden) => {
            Object.defineProperty(document, 'hidden', { value: hidden, configurable: true });
            document.dispatchEvent(new Event('visibilitychange'));
        }"""
        page.evaluate(set_hidden, True)
        wait_until(page, "live.source === null")
        page.wait_for_timeout(500)
        assert hub.num_viewers == 0
        step = page.evaluate("player.store.lastStep")
        page.evaluate(set_hidden, False)
        wait_until(page, f"{NEAR} && player.store.lastStep > {step} + 10")
        assert hub.num_viewers == 1
        # The rows that came again are not there twice, and none are missing.
        steps = page.evaluate("player.store.chunks.map((one) => [one.firstStep, one.lastStep])")
        assert steps[0][0] == 0
        assert all(one[1] + 1 == other[0] for one, other in pairwise(steps))


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_a_phone_shows_it(server, open_page, scheme):
    with open_page(server.address, width=390, height=844, color_scheme=scheme) as page:
        wait_until(page, f"{NEAR} && player.store.lastTime > 4")
        page.evaluate("player.clock.seek(0)")
        page.evaluate(DRAWN)
        box = page.locator("#to-live").bounding_box()
        assert 0 <= box["x"] <= 390 - box["width"]
        assert box["height"] >= 30
        assert page.evaluate("document.documentElement.scrollWidth") <= 390
