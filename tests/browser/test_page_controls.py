"""The replay page in a browser: what it does when one presses and clicks, and on which screens."""

import numpy as np
import pytest
from browser.replays import PIXEL, SEEK, check_cars, project, time_of, view_of
from browser.waiting import wait_until

pytestmark = pytest.mark.slow


def test_play_pause_steps_and_speed(replay, open_page):
    dt = replay.scenario.time_step
    with open_page(replay.address) as page:
        assert time_of(page) == 0.0
        page.get_by_role("button", name="One step forward").click()
        page.get_by_role("button", name="One step forward").click()
        assert time_of(page) == pytest.approx(2 * dt)
        page.get_by_role("button", name="One step back").click()
        assert time_of(page) == pytest.approx(dt)
        page.get_by_label("Speed", exact=True).select_option("5")
        page.get_by_role("button", name="Play", exact=True).click()
        wait_until(page, "player.clock.time > 1.5")
        page.get_by_role("button", name="Pause").click()
        stopped = time_of(page)
        page.wait_for_timeout(150)
        assert time_of(page) == stopped
        page.locator("#scrub").fill("20")
        assert time_of(page) == 20.0
        wait_until(page, "document.getElementById('time').textContent === '20.0 / 42.0 s'")
        page.evaluate("player.clock.seek(1e9)")
        assert time_of(page) == pytest.approx(42.0)
        # At the end it plays from the start.
        page.get_by_role("button", name="Play", exact=True).click()
        wait_until(page, "player.clock.time < 20")


def test_zoom_and_follow(replay, open_page):
    with open_page(replay.address) as page:
        before = view_of(page)
        page.get_by_role("button", name="Zoom in").click()
        assert view_of(page)["scale"] == pytest.approx(1.25 * before["scale"])
        page.get_by_role("button", name="Zoom out").click()
        page.mouse.move(400, 150)
        page.mouse.wheel(0, -300)
        wait_until(page, "(scale) => player.camera.scale > scale", before["scale"])
        follow = page.get_by_role("button", name="Follow the selected vehicle")
        assert follow.get_attribute("aria-pressed") == "true"
        page.evaluate(SEEK, 10.0)
        followed = view_of(page)["position"]
        page.mouse.down()
        page.mouse.move(300, 150, steps=4)
        page.mouse.up()
        moved = view_of(page)
        assert moved["position"] == pytest.approx(followed + 100 / moved["scale"], abs=0.5)
        assert follow.get_attribute("aria-pressed") == "false"
        page.evaluate(SEEK, 12.0)
        assert view_of(page)["position"] == moved["position"]
        follow.click()
        page.evaluate(SEEK, 12.0)
        assert view_of(page)["position"] != moved["position"]


def test_a_click_selects_a_car(replay, open_page):
    with open_page(replay.address) as page:
        page.evaluate(SEEK, 5.0)
        view, rows = view_of(page), replay.at(50)
        xs, ys = project(replay, rows, view)
        selected = page.evaluate("player.selection.vehicle")
        is_in = (np.abs(xs - 400) < 300) & (rows["vehicle"] != selected)
        index = int(np.flatnonzero(is_in)[0])
        page.locator("#road").click(position={"x": float(xs[index]), "y": float(ys[index])})
        vehicle = int(rows["vehicle"][index])
        assert page.evaluate("player.selection.vehicle") == vehicle
        wait_until(page, f"document.getElementById('facts').textContent.includes({vehicle})")
        assert str(vehicle) in page.locator("#plots-title").text_content()
        speed = f"{rows['speed'][index]:.1f} m/s"
        assert speed in page.locator("#facts").text_content()


def test_fragments(replay, open_page):
    command = replay.commands[1]
    dt = replay.scenario.time_step
    with open_page(f"{replay.address}#command={command.command}") as page:
        assert time_of(page) == pytest.approx(command.first_step * dt)
        assert page.evaluate("player.selection.vehicle") == command.vehicle
        vehicle = int(replay.at(150)["vehicle"][0])
        page.evaluate(f"location.hash = '#t=15&vehicle={vehicle}'")
        wait_until(page, "player.clock.time === 15")
        assert page.evaluate("player.selection.vehicle") == vehicle
        wait_until(page, f"location.hash === '#t=15.0&vehicle={vehicle}'")
        page.evaluate("player.clock.seek(17.3)")
        wait_until(page, f"location.hash === '#t=17.3&vehicle={vehicle}'")
        page.evaluate("location.hash = '#command=99'")
        page.get_by_text("This replay has no maneuver 99.").wait_for()
        page.evaluate("location.hash = '#vehicle=-5'")
        page.get_by_text("This replay has no vehicle -5.").wait_for()


def test_keys(replay, open_page):
    dt = replay.scenario.time_step
    with open_page(replay.address) as page:
        press = page.keyboard.press
        press("ArrowRight")
        press("ArrowRight")
        press("ArrowLeft")
        assert time_of(page) == pytest.approx(dt)
        press(" ")
        wait_until(page, "player.clock.isPlaying")
        press(" ")
        assert not page.evaluate("player.clock.isPlaying")
        press("ArrowUp")
        assert page.evaluate("player.clock.speed") == 2
        press("ArrowDown")
        press("Home")
        press("]")
        assert time_of(page) == pytest.approx(replay.events[0].step * dt)
        press("]")
        later = next(one.step for one in replay.events if one.step > replay.events[0].step)
        assert time_of(page) == pytest.approx(later * dt)
        press("[")
        assert time_of(page) == pytest.approx(replay.events[0].step * dt)
        scale = view_of(page)["scale"]
        press("+")
        assert view_of(page)["scale"] > scale
        press("-")
        press("f")
        assert not page.evaluate("player.selection.isFollowing")
        press("End")
        assert time_of(page) == pytest.approx(42.0)
        press("?")
        dialog = page.get_by_role("dialog")
        assert dialog.is_visible()
        assert dialog.locator("dt").count() == page.evaluate("player.keyboard.keys.length")
        press("Escape")
        assert not dialog.is_visible()


def test_tab_reaches_the_controls_and_the_focus_is_seen(replay, open_page):
    with open_page(replay.address) as page:
        reached = set()
        for _ in range(12):
            page.keyboard.press("Tab")
            reached.add(page.evaluate("document.activeElement.id"))
            style = "getComputedStyle(document.activeElement)"
            assert page.evaluate(f"{style}.outlineStyle") == "solid"
            assert page.evaluate(f"parseFloat({style}.outlineWidth)") >= 2
        assert {"theme", "show-help", "road", "zoom-in", "follow", "play", "scrub"} <= reached
        nameless = page.locator("button, select, input, canvas[role=img]").evaluate_all(
            "all => all.filter((one) => !(one.getAttribute('aria-label') || one.textContent.trim()"
            " || one.labels?.length)).map((one) => one.outerHTML)"
        )
        assert nameless == []


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_dark_and_light(replay, open_page, scheme):
    with open_page(replay.address, color_scheme=scheme) as page:
        background = "getComputedStyle(document.body).backgroundColor"
        ground = page.evaluate(PIXEL, [5, 5])
        first = sum(map(int, page.evaluate(f"{background}.match(/\\d+/g)")))
        assert (first > 600) == (scheme == "light")
        page.get_by_role("button", name="Dark or light").click()
        second = sum(map(int, page.evaluate(f"{background}.match(/\\d+/g)")))
        assert (second > 600) != (scheme == "light")
        page.evaluate(SEEK, 1.0)
        assert page.evaluate(PIXEL, [5, 5]) != ground


@pytest.mark.parametrize("width", [390, 820])
def test_narrow_screens(replay, open_page, width):
    options = {"has_touch": True, "is_mobile": True} if width == 390 else {}
    with open_page(replay.address, width=width, height=844, **options) as page:
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        play = page.get_by_role("button", name="Play", exact=True)
        box = play.bounding_box()
        assert 0 <= box["x"] < box["x"] + box["width"] <= width
        if width == 390:
            # Within the thumb's reach, wherever one has scrolled to, and large enough for it.
            assert box["height"] >= 40
            page.locator("#grid figure").last.scroll_into_view_if_needed()
            assert play.bounding_box()["y"] == pytest.approx(box["y"], abs=1)
            assert box["y"] > 0.75 * 844
            play.tap()
            wait_until(page, "player.clock.time > 0.2")
        assert check_cars_in_view(replay, page)


def check_cars_in_view(replay, page):
    page.evaluate("document.documentElement.scrollTop = 0")
    return check_cars(replay, page, replay.completed.last_step - 3) >= 1


def test_sharp_on_screens_with_more_pixels(replay, open_page):
    with open_page(replay.address, device_scale_factor=2) as page:
        size = page.evaluate("[player.canvas.width, player.canvas.clientWidth]")
        assert size[0] == 2 * size[1]


def test_motion_can_be_reduced(replay, open_page):
    with open_page(replay.address, reduced_motion="reduce") as page:
        page.evaluate(SEEK, 5.0)
        rows = replay.at(50)
        near = np.argsort(np.abs(rows["position"] - view_of(page)["position"]))[1]
        vehicle = int(rows["vehicle"][near])
        page.evaluate("(id) => player.selection.choose(id, 50)", vehicle)
        page.evaluate(SEEK, 5.0)
        assert view_of(page)["position"] == pytest.approx(rows["position"][near], abs=2e-3)
