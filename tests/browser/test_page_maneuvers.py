"""The maneuvers on the replay page in a browser: marks, list, filter, plots and what is written."""

import re

import pytest
from browser.replays import SEEK, time_of

from marl_lanes import load_scenario
from marl_lanes.browser.bundle import write_replay
from marl_lanes.browser.optima import find_optima
from marl_lanes.trajectory.file import Trajectory
from marl_lanes.trajectory.metadata import Metadata

pytestmark = pytest.mark.slow


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
