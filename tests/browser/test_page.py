"""The replay page in a browser: what it draws, and what it does when one presses and clicks."""

import math
import re

import numpy as np
import pytest
from browser.waiting import wait_until
from recordings import record

from marl_lanes import load_scenario
from marl_lanes.browser.bundle import write_replay
from marl_lanes.browser.optima import find_optima
from marl_lanes.colours import TRAFFIC
from marl_lanes.trajectory.events import find_commands, find_events
from marl_lanes.trajectory.file import Trajectory
from marl_lanes.trajectory.metadata import Metadata
from marl_lanes.trajectory.road_line import RoadLine

pytestmark = pytest.mark.slow

PIXEL = """([x, y]) => {
    const [r, g, b] = player.canvas.getContext('2d').getImageData(x, y, 1, 1).data;
    return '#' + [r, g, b].map((one) => one.toString(16).padStart(2, '0')).join('');
}"""
SEEK = """async (time) => {
    player.clock.pause();
    player.clock.seek(time);
    // The camera may glide for some frames.
    do await new Promise((drawn) => requestAnimationFrame(() => requestAnimationFrame(drawn)));
    while (player.isDirty);
}"""


class Replay:
    """A trajectory with its page."""

    def __init__(self, folder, trajectory):
        self.trajectory = trajectory
        self.rows = trajectory.rows_of(0)
        self.scenario = trajectory.scenario
        self.commands = find_commands(self.rows)
        self.events = find_events(self.rows)
        path = folder / "replay.html"
        write_replay(path, trajectory, 0, find_optima(self.rows, self.scenario))
        self.address = path.as_uri()

    def at(self, step):
        return self.rows[self.rows["step"] == step]

    def row(self, vehicle, step):
        (row,) = self.at(step)[self.at(step)["vehicle"] == vehicle]
        return row

    @property
    def completed(self):
        return next(one for one in self.commands if one.outcome.name == "COMPLETED")


@pytest.fixture(scope="module")
def replay(tmp_path_factory):
    """Interactive traffic, with aborts."""
    return Replay(tmp_path_factory.mktemp("interactive"), record("interactive", 420))


@pytest.fixture(scope="module")
def curved(tmp_path_factory):
    return Replay(tmp_path_factory.mktemp("curved"), record("curved", 300))


def project(replay, rows, view):
    """Pixels of the rows' centres, computed here from what the camera says of itself."""
    line, road = RoadLine(replay.scenario), replay.scenario.road
    x, y, _ = line.place(rows["position"], rows["lateral_position"])
    middle = 0.5 * road.num_lanes * road.lane_width
    x0, y0, heading = line.place(view["position"], middle)
    cosine, sine = math.cos(heading), math.sin(heading)
    right = (x - x0) * cosine + (y - y0) * sine
    up = (y - y0) * cosine - (x - x0) * sine
    return view["width"] / 2 + view["scale"] * right, view["height"] / 2 - view["scale"] * up


def view_of(page):
    return page.evaluate(
        "({position: player.camera.position, scale: player.camera.scale, "
        "width: player.camera.width, height: player.camera.height})"
    )


def time_of(page):
    return page.evaluate("player.clock.time")


def check_cars(replay, page, step):
    """The colours at the centres of all vehicles in view; the number of changers among them."""
    page.evaluate(SEEK, step * replay.scenario.time_step)
    view, rows = view_of(page), replay.at(step)
    xs, ys = project(replay, rows, view)
    changers = 0
    for row, x, y in zip(rows, xs, ys, strict=True):
        if 20 < x < view["width"] - 120 and 20 < y < view["height"] - 20:
            is_changer = row["command"] >= 0
            expected = TRAFFIC.changer if is_changer else TRAFFIC.vehicle
            assert page.evaluate(PIXEL, [float(x), float(y)]) == expected, row["vehicle"]
            changers += is_changer
    return changers


def test_cars_are_where_the_trajectory_says(replay, open_page):
    with open_page(replay.address) as page:
        found = 0
        for command in replay.commands[:3]:
            page.evaluate("(k) => player.selection.setAuto(true)", command.command)
            found += check_cars(replay, page, command.last_step - 3)
        assert found >= 3


def test_cars_are_on_the_curved_road(curved, open_page):
    with open_page(curved.address) as page:
        command = curved.completed
        assert check_cars(curved, page, (command.first_step + command.last_step) // 2) >= 1
        # The road bends: far from the camera it is not where a straight one would be.
        view = view_of(page)
        width = curved.scenario.road.lane_width
        places = np.zeros(2, curved.rows.dtype)
        places["position"] = view["position"] + 0.45 * view["width"] / view["scale"]
        places["lateral_position"] = -0.6, -2.5
        xs, ys = project(curved, places, view)
        middle = 0.5 * curved.scenario.road.num_lanes * width
        straight = view["height"] / 2 + view["scale"] * (middle - places["lateral_position"])
        assert np.abs(ys - straight).min() > 15
        on, beside = (
            page.evaluate(PIXEL, [float(x), float(y)]) for x, y in zip(xs, ys, strict=True)
        )
        assert on == TRAFFIC.road != beside


def test_a_lane_change_is_seen(replay, open_page):
    command = replay.completed
    with open_page(f"{replay.address}#command={command.command}") as page:
        heights = []
        for step in (command.engaged_steps[-1], command.last_step):
            page.evaluate(SEEK, step * replay.scenario.time_step)
            view = view_of(page)
            red = page.evaluate(
                """([x, wanted]) => {
                    const { canvas } = player;
                    const data = canvas.getContext('2d').getImageData(x, 0, 1, canvas.height).data;
                    const found = [];
                    for (let y = 0; y < canvas.height; y += 1) {
                        const rgb = data.slice(4 * y, 4 * y + 3);
                        if (wanted.every((one, i) => one === rgb[i])) found.push(y);
                    }
                    return found;
                }""",
                [view["width"] / 2 - 5, list(bytes.fromhex(TRAFFIC.changer[1:]))],
            )
            heights.append(float(np.mean(red)))
        row = replay.row(command.vehicle, command.first_step)
        moved = (heights[0] - heights[1]) / view["scale"] * row["direction"]
        assert moved == pytest.approx(replay.scenario.road.lane_width, abs=0.6)


WRITTEN = """() => {
    const written = [];
    const { prototype } = CanvasRenderingContext2D;
    const write = prototype.fillText;
    prototype.fillText = function (text, x, y) {
        if (this.canvas === player.canvas && this.font.includes('13px')) {
            const half = this.measureText(text).width / 2;
            written.push([x - half, x + half]);
        }
        write.call(this, text, x, y);
    };
    player.draw(0);
    prototype.fillText = write;
    return written;
}"""


def test_the_gaps_length_is_not_under_the_changer(replay, open_page):
    found = 0
    with open_page(replay.address) as page:
        for command in replay.commands:
            page.evaluate("(hash) => { location.hash = hash; }", f"#command={command.command}")
            for step in range(command.first_step, command.last_step, 20):
                page.evaluate(SEEK, step * replay.scenario.time_step)
                view = view_of(page)
                half = 0.5 * replay.scenario.vehicle.length * view["scale"]
                for left, right in page.evaluate(WRITTEN):
                    found += 1
                    assert right < view["width"] / 2 - half or left > view["width"] / 2 + half
    assert found >= 10


def test_no_gap_is_drawn_once_the_change_is_completed(replay, open_page):
    command = replay.completed
    with open_page(f"{replay.address}#command={command.command}") as page:
        for step, is_drawn in ((command.last_step - 1, True), (command.last_step, False)):
            page.evaluate(SEEK, step * replay.scenario.time_step)
            assert bool(page.evaluate(WRITTEN)) == is_drawn


def test_between_two_steps_cars_are_between(replay, open_page):
    command = replay.completed
    dt = replay.scenario.time_step
    with open_page(replay.address) as page:
        page.evaluate(SEEK, (command.first_step + 0.5) * dt)
        place = page.evaluate(
            "(id) => { const i = player.scene.find(id);"
            " return [player.scene.position[i], player.scene.lateral[i]]; }",
            command.vehicle,
        )
        rows = [replay.row(command.vehicle, command.first_step + k) for k in (0, 1)]
        for value, name in zip(place, ("position", "lateral_position"), strict=True):
            assert value == pytest.approx(np.mean([row[name] for row in rows]), abs=2e-3)


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


def test_marks_are_the_events(replay, open_page):
    with open_page(replay.address) as page:
        for kind in ("command", "engaged", "aborted", "completed", "missed", "collision"):
            expected = [event for event in replay.events if event.kind == kind]
            marks = page.locator(f".track .mark.{kind}")
            assert marks.count() == len(expected)
            assert page.locator(f".lane.{kind} b").text_content() == str(len(expected))
            for event in expected[:2]:
                # Where marks overlap, the mouse would take another one.
                marks.nth(expected.index(event)).dispatch_event("click")
                now = event.step * replay.scenario.time_step
                assert time_of(page) == pytest.approx(now)
                assert page.evaluate("player.selection.vehicle") == event.vehicle
        assert page.locator(".track .mark.aborted").count() > 0


def test_a_mark_is_clicked_with_the_mouse(replay, open_page):
    with open_page(replay.address) as page:
        event = next(one for one in replay.events if one.kind == "completed")
        mark = page.locator(".track .mark.completed").first
        mark.click()
        assert time_of(page) == pytest.approx(event.step * replay.scenario.time_step)
        x = mark.bounding_box()["x"] + mark.bounding_box()["width"] / 2
        head = page.locator(".head").bounding_box()["x"] + 1
        assert head == pytest.approx(x, abs=2)
        # A click beside the marks goes to that time.
        track = page.locator(".lane.command .track").bounding_box()
        page.mouse.click(track["x"] + 0.9 * track["width"], track["y"] + track["height"] / 2)
        assert time_of(page) == pytest.approx(0.9 * 42.0, abs=0.2)


def test_the_list_and_its_filter(replay, open_page):
    with open_page(replay.address) as page:
        rows = page.locator("#rows tr")
        assert rows.count() == len(replay.commands)
        page.get_by_label("with aborts").check()
        aborted = [one for one in replay.commands if one.num_aborts]
        assert 0 < len(aborted) < len(replay.commands)
        assert rows.count() == len(aborted)
        assert (
            page.locator("#num-found").text_content() == f"{len(aborted)} of {len(replay.commands)}"
        )
        # The marks of the others are dim.
        shown = {f"changer_{one.command}" for one in aborted}
        for mark in page.locator(".track .mark.command").all():
            is_shown = any(f"of {name}," in mark.get_attribute("title") for name in shown)
            assert ("dim" in mark.get_attribute("class")) != is_shown
        rows.last.get_by_role("button").click()
        assert time_of(page) == pytest.approx(aborted[-1].first_step * replay.scenario.time_step)
        assert page.evaluate("player.selection.vehicle") == aborted[-1].vehicle
        assert rows.last.get_attribute("aria-current") == "true"
        page.get_by_label("with aborts").uncheck()
        page.get_by_label("not completed").check()
        failed = [one for one in replay.commands if one.outcome.name != "COMPLETED"]
        assert rows.count() == len(failed)


def test_hard_braking_is_found_by_its_threshold(replay, open_page):
    with open_page(replay.address) as page:
        marks = page.locator(".track .mark.braking")
        limit = 1.2
        page.get_by_label("hard: over").fill(str(limit))
        hard = replay.rows[replay.rows["acceleration"] < -limit - 1e-3]
        titles = marks.evaluate_all("all => all.map((one) => one.title)")
        found = [
            re.fullmatch(r"hard braking of vehicle (\d+), .* s, (.*) m/s²", one) for one in titles
        ]
        assert {int(one[1]) for one in found} == set(hard["vehicle"].tolist())
        assert min(float(one[2]) for one in found) >= limit
        # The hardest is the first of the list, and a click goes there.
        first = page.locator("#brakings button").first
        hardest = f"{-replay.rows['acceleration'].min():.1f} m/s²"
        assert first.text_content().startswith(hardest)
        first.click()
        page.evaluate(SEEK, time_of(page))
        vehicle, step = page.evaluate("[player.selection.vehicle, player.scene.step]")
        assert f"{-replay.row(vehicle, step)['acceleration']:.1f} m/s²" == hardest
        page.get_by_role("checkbox", name="hard braking").check()
        page.get_by_label("hard: over").fill("15")
        assert marks.count() == 0
        assert page.locator("#rows tr").count() == 0
        assert page.locator("#none").is_visible()
        assert "No vehicle brakes harder" in page.locator("#brakings-note").text_content()


def test_plots_show_the_rows_and_the_optimum(replay, open_page):
    command = replay.completed
    with open_page(f"{replay.address}#command={command.command}") as page:
        keys = page.locator("#grid figure").evaluate_all("all => all.map((one) => one.dataset.key)")
        assert keys == [
            *("speed", "gaps", "acceleration", "lateral"),
            *("yawRate", "yawAcceleration", "reward"),
        ]
        captions = page.locator("#grid .title").all_text_contents()
        assert "Speed [m/s]" in captions
        assert "Yaw acceleration [rad/s²]" in captions
        step = command.engaged_steps[-1] + 10
        page.evaluate(SEEK, step * replay.scenario.time_step)
        row = replay.row(command.vehicle, step)
        values = {key: page.locator(f"[data-key={key}] output").all_text_contents() for key in keys}
        assert float(values["speed"][0]) == pytest.approx(row["speed"], abs=0.06)
        lateral = [float(value) for value in values["lateral"]]
        assert lateral[0] == pytest.approx(row["lateral_position"], abs=0.006)
        optimum = find_optima(replay.rows, replay.scenario)[command.command]
        assert lateral[1] == pytest.approx(optimum["lateral_position"][10], abs=0.006)
        leader = replay.row(int(row["leader"]), step)
        assert float(values["speed"][1]) == pytest.approx(leader["speed"], abs=0.06)
        gap = leader["position"] - row["position"] - replay.scenario.vehicle.length
        assert float(values["gaps"][0]) == pytest.approx(gap, rel=0.01)
        text = page.locator("#optimum").text_content()
        assert f"optimum {optimum['cost']:.2f}" in text
        assert f"Cost driven {optimum['driven_cost']:.2f}" in text
        # Lines are drawn: the plot has pixels in the colour of the first line.
        assert page.locator("[data-key=speed] .area canvas").evaluate(
            """(canvas) => {
                const digits = player.theme.colours.series[0].match(/\\w\\w/g);
                const wanted = digits.map((one) => parseInt(one, 16));
                const { width, height } = canvas;
                const { data } = canvas.getContext('2d').getImageData(0, 0, width, height);
                let count = 0;
                for (let i = 0; i < data.length; i += 4) {
                    if (wanted.every((one, k) => Math.abs(one - data[i + k]) < 8)) count += 1;
                }
                return count > 50;
            }"""
        )


def test_the_ghost_of_the_optimum_is_on_the_road(curved, open_page):
    """On the curved road the optimum differs most from what was driven."""
    command = curved.completed
    optimum = find_optima(curved.rows, curved.scenario)[command.command]
    places = np.zeros(len(optimum["position"]), curved.rows.dtype)
    places["position"] = optimum["position"]
    places["lateral_position"] = optimum["lateral_position"]
    now = 20
    with open_page(f"{curved.address}#command={command.command}") as page:
        bright = []
        for optima in ("player.optima", "{}"):
            page.evaluate(f"player.setOptima({optima})")
            page.evaluate(SEEK, (optimum["first_step"] + now) * curved.scenario.time_step)
            xs, ys = project(curved, places, view_of(page))
            pixels = [
                page.evaluate(PIXEL, [float(x), float(y)]) for x, y in zip(xs, ys, strict=True)
            ]
            bright.append([min(bytes.fromhex(pixel[1:])) > 150 for pixel in pixels])
        # The path is dashed, and elsewhere there is no white line.
        assert sum(bright[0][now + 5 : now + 15]) >= 2
        assert not any(bright[1][now + 5 : now + 15])


def test_the_ghosts_car_is_where_the_optimum_is(curved, open_page):
    command = curved.completed
    optimum = find_optima(curved.rows, curved.scenario)[command.command]
    keep = """() => {
        const { canvas } = player;
        const size = [0, 0, canvas.width, canvas.height];
        window.before = window.after;
        window.after = canvas.getContext('2d').getImageData(...size).data;
    }"""
    with open_page(f"{curved.address}#command={command.command}") as page:
        page.evaluate(SEEK, (optimum["first_step"] + 20) * curved.scenario.time_step)
        page.evaluate(keep)
        # Only the car is left out.
        page.evaluate("player.ghost.drawCar = () => {}")
        page.evaluate(SEEK, (optimum["first_step"] + 20) * curved.scenario.time_step)
        page.evaluate(keep)
        changed = page.evaluate(
            "[...after.keys()].filter((i) => i % 4 === 0 && after[i] !== before[i])"
            ".map((i) => (i / 4) % player.canvas.width)"
        )
        view = view_of(page)
        place = np.zeros(1, curved.rows.dtype)
        place["position"] = optimum["position"][20]
        place["lateral_position"] = optimum["lateral_position"][20]
        ((x,), _) = project(curved, place, view)
        half = 0.5 * view["scale"] * curved.scenario.vehicle.length
        assert min(changed) == pytest.approx(x - half, abs=4)
        assert max(changed) == pytest.approx(x + half, abs=4)


def test_where_there_is_no_optimum_the_page_says_why(replay, open_page):
    failed = [one for one in replay.commands if one.outcome.name != "COMPLETED"]
    assert failed
    with open_page(f"{replay.address}#command={failed[0].command}") as page:
        text = page.locator("#optimum").text_content()
        assert text == "No optimum: the change was not completed."


def test_a_click_in_a_plot_goes_to_that_time(replay, open_page):
    command = replay.completed
    with open_page(f"{replay.address}#command={command.command}") as page:
        canvas = page.locator("[data-key=speed] .area canvas")
        canvas.scroll_into_view_if_needed()
        box = canvas.bounding_box()
        page.mouse.move(box["x"] + 0.5 * box["width"], box["y"] + 60)
        page.mouse.down()
        first = time_of(page)
        page.mouse.move(box["x"] + 0.8 * box["width"], box["y"] + 60, steps=3)
        page.mouse.up()
        assert time_of(page) > first > 0
        head = page.locator("[data-key=speed] .cursor").bounding_box()
        assert head["x"] + 1 == pytest.approx(box["x"] + 0.8 * box["width"], abs=2)


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


def test_a_hostile_name_is_text(replay, open_page, tmp_path):
    hostile = "<script>window.owned = 1</script><img src=x onerror='window.owned = 2'>"
    fields = replay.scenario.model_dump(mode="json") | {"name": hostile, "description": hostile}
    trajectory = Trajectory(Metadata(load_scenario(fields), 0, hostile), replay.rows)
    path = tmp_path / "hostile.html"
    write_replay(path, trajectory, 0, {0: {"reason": hostile}})
    with open_page(f"{path.as_uri()}#command=0") as page:
        assert page.locator("h1").text_content() == hostile
        assert hostile in page.locator("#subtitle").text_content()
        assert hostile in page.locator("#optimum").text_content()
        assert page.locator("img").count() == 0
        assert page.evaluate("window.owned") is None


def test_a_vehicle_is_known_while_it_is_on_the_road(replay, open_page):
    vehicle = int(replay.at(100)["vehicle"][-1])
    steps = replay.rows["step"][replay.rows["vehicle"] == vehicle]
    first, last = int(steps.min()), int(steps.max())
    assert first > 0
    read = "([vehicle, step]) => player.store.read(vehicle, step)"
    with open_page(replay.address) as page:
        assert page.evaluate("(id) => player.store.spanOf(id)", vehicle) == [first, last]
        for step in (first, last):
            found = page.evaluate(read, [vehicle, step])
            row = replay.row(vehicle, step)
            assert found["position"] == pytest.approx(row["position"], abs=1e-3)
        for gone in (first - 1, last + 1, -5, 10_000):
            assert page.evaluate(read, [vehicle, gone]) is None
        assert page.evaluate(read, [10**6, first]) is None


def test_chunks_of_a_stream_are_one_road(replay, open_page):
    """The store after three chunks, and after the first is dropped."""
    from marl_lanes.browser.encoding import encode_chunk

    rows = replay.rows
    chunks = [
        encode_chunk(rows[(rows["step"] >= first) & (rows["step"] <= last)], [])
        for first, last in ((0, 99), (100, 250), (251, 420))
    ]
    with open_page(replay.address) as page:
        page.evaluate(SEEK, 30.0)
        expected = page.evaluate("[...player.scene.position.slice(0, player.scene.count)]")
        page.evaluate(
            "async (chunks) => { player.store.clear();"
            " for (const one of chunks) await player.store.append(one); }",
            chunks,
        )
        # Between two chunks: a vehicle's place is between those of both.
        for time in (30.0, 25.05):
            page.evaluate(SEEK, time)
            found = page.evaluate(
                "Object.fromEntries([...player.scene.index].map("
                "([id, i]) => [id, player.scene.position[i]]))"
            )
            for row in replay.at(int(time * 10)):
                vehicle = int(row["vehicle"])
                after = replay.at(int(time * 10) + 1)
                after = after[after["vehicle"] == vehicle]["position"]
                share = 10 * time - int(time * 10)
                place = row["position"] + (
                    share * (after[0] - row["position"]) if after.size else 0
                )
                assert found[str(vehicle)] == pytest.approx(place, abs=2e-3)
        page.evaluate(SEEK, 30.0)
        again = page.evaluate("[...player.scene.position.slice(0, player.scene.count)]")
        assert sorted(again) == pytest.approx(sorted(expected), abs=1e-9)


def test_a_truck_is_drawn_as_long_as_it_is(tmp_path, open_page):
    """Its ends are 8.25 m from its centre; and gaps are between bumpers."""
    replay = Replay(tmp_path, record("trucks", 160, seed=5))
    (command,) = (one for one in replay.commands if one.command == 0)
    step = command.engaged_steps[0] + 3
    with open_page(f"{replay.address}#command=0") as page:
        page.evaluate(SEEK, step * replay.scenario.time_step)
        (row,) = replay.at(step)[replay.at(step)["vehicle"] == command.vehicle]
        assert (row["length"], row["width"]) == (16.5, 2.55)
        for ahead, is_body in ((-7.9, True), (4.0, True), (5.4, False), (6.5, True), (-9.5, False)):
            place = np.array([row])
            place["position"] += ahead
            (x,), (y,) = project(replay, place, view_of(page))
            assert (page.evaluate(PIXEL, [float(x), float(y)]) == TRAFFIC.changer) == is_body, ahead
        leader = replay.row(int(row["target_leader"]), step)
        gap = leader["position"] - row["position"] - 0.5 * (row["length"] + leader["length"])
        values = page.locator("[data-key=gaps] output").all_text_contents()
        assert float(values[1]) == pytest.approx(gap, rel=0.01)
