"""A browser for the tests of the page, started once for a module, pages of it, and replays."""

import os
import shutil
from contextlib import contextmanager

import pytest
from browser.replays import Replay
from browser.waiting import wait_until
from recordings import record

NAMES = ("chromium", "chromium-browser", "google-chrome")
OPTIONS = [
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
]


def find_browser(playwright):
    """Path of the system's Chromium, or of Playwright's own, or None."""
    own = playwright.chromium.executable_path
    return next(filter(None, map(shutil.which, (*NAMES, own))), None)


def is_fault(message):
    """Whether a page's message on the console is a fault of the page."""
    # The tests read pixels more often than the browser thinks good.
    return "getImageData" not in message.text


@pytest.fixture(scope="module")
def browser():
    """Headless Chromium; without it the tests are skipped, but fail where CI is set."""
    sync_api = pytest.importorskip("playwright.sync_api")
    with sync_api.sync_playwright() as playwright:
        path = find_browser(playwright)
        if path is None:
            reason = f"no browser: none of {', '.join(NAMES)} on the path, nor Playwright's own"
            if os.environ.get("CI"):
                pytest.fail(reason)
            pytest.skip(reason)
        started = playwright.chromium.launch(executable_path=path, args=OPTIONS)
        yield started
        started.close()


@pytest.fixture
def open_page(browser):
    """Opens an address in a page of its own, which must not log an error or request anything."""

    @contextmanager
    def opened(address, *, width=1280, height=900, **options):
        context = browser.new_context(viewport={"width": width, "height": height}, **options)
        page = context.new_page()
        errors, requests = [], []
        page.on("console", lambda message: is_fault(message) and errors.append(message.text))
        page.on("pageerror", lambda error: errors.append(str(error)))
        page.on("request", lambda request: requests.append(request.url))
        page.goto(address)
        wait_until(page, "window.player !== undefined && player.scene.count > 0")
        try:
            yield page
        finally:
            context.close()
        assert errors == []
        foreign = [url for url in requests if not url.startswith(("data:", address.split("#")[0]))]
        assert foreign == []

    return opened


@pytest.fixture(scope="module")
def replay(tmp_path_factory):
    """Interactive traffic, with aborts."""
    return Replay(tmp_path_factory.mktemp("interactive"), record("interactive", 420))


@pytest.fixture(scope="module")
def curved(tmp_path_factory):
    return Replay(tmp_path_factory.mktemp("curved"), record("curved", 300))
