"""The road on the replay page in a browser: cars, gaps and the optimum's ghost, where they are."""

import numpy as np
import pytest
from browser.replays import PIXEL, SEEK, Replay, check_cars, project, view_of
from recordings import record

from marl_lanes.browser.optima import find_optima
from marl_lanes.colours import TRAFFIC

pytestmark = pytest.mark.slow


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
