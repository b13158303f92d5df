import numpy as np
import pytest
import recordings

from marl_lanes import Simulator, load_scenario
from marl_lanes.traffic.machine.state import NONE, Fate, Outcome, Phase
from marl_lanes.traffic.roles.changer import CHANGER
from marl_lanes.traffic.roles.follower import FOLLOWER
from marl_lanes.trajectory.frames import FrameReader


def started(scenario="paper", num_envs=1, *, seed=0, **options):
    simulator = Simulator(scenario, num_envs, seed=seed, **options)
    simulator.reset()
    return simulator


def test_a_row_holds_what_the_tables_hold():
    simulator = started("interactive", 2)
    reader = FrameReader(simulator)
    seen = {"commanded": 0, "behind": 0}
    for _ in recordings.drive(simulator, 150):
        rows = reader.read()
        vehicles, agents = simulator.vehicles, simulator.agents
        for road in range(2):
            slots = simulator.state.order[road, : simulator.roads["num_vehicles"][road]]
            here = rows[(rows["road"] == road) & (rows["fate"] == Fate.STAYS)]
            assert sorted(here["vehicle"]) == sorted(vehicles["id"][road, slots])
            by_id = {row["vehicle"]: row for row in here}
            for slot in slots:
                car = vehicles[road, slot]
                row = by_id[car["id"]]
                for name in ("position", "lateral_position", "speed", "yaw", "acceleration"):
                    assert row[name] == np.asarray(car[name], row[name].dtype)
                if car["agent"] == NONE:
                    continue
                agent = agents[road, car["agent"]]
                seen["commanded"] += 1
                assert (row["command"], row["phase"]) == (agent["command"], agent["phase"])
                assert row["reward"] == np.float32(agent["reward"])
                for name, value in CHANGER.terms_of(agent).items():
                    assert row[name] == np.float32(value)
                if agent["target_follower"] != NONE:
                    seen["behind"] += 1
                    assert row["target_follower"] == vehicles["id"][road, agent["target_follower"]]
    assert min(seen.values()) > 50


def test_deviation_is_that_of_the_observation():
    simulator = started()
    column = list(simulator.scenario.observation.features).index("lateral_deviation")
    reader = FrameReader(simulator)
    checked = 0
    for _ in recordings.drive(simulator, 200):
        rows = reader.read()
        for slot in np.flatnonzero(simulator.is_live[0]):
            command = simulator.agents["command"][0, slot]
            (row,) = rows[rows["command"] == command]
            seen = simulator.state.observations[0, slot, column]
            assert row["lateral_deviation"] == pytest.approx(seen, abs=1e-5)
            checked += 1
    assert checked > 50


def test_actions_are_those_that_had_an_effect():
    simulator = started()
    reader = FrameReader(simulator)
    checked = 0
    before = {}
    for _ in recordings.drive(simulator, 250):
        rows = reader.read()
        for row in rows[rows["command"] != NONE]:
            was_steering = before.get(row["command"], Phase.WAITING) != Phase.WAITING
            action = row["action_yaw_acceleration"]
            assert np.isfinite(action) == was_steering
            assert np.isnan(row["action_acceleration"])
            if was_steering:
                # The speed of these changes is far from the bound of the yaw rate.
                assert row["yaw_acceleration"] == pytest.approx(row["direction"] * action, abs=1e-6)
                checked += 1
        before = {row["command"]: row["phase"] for row in rows[rows["command"] != NONE]}
    assert checked > 50


def test_removed_vehicles_are_there_in_the_step_that_removes_them():
    rows = recordings.crashes().rows
    collided, lost = rows["fate"] == Fate.COLLIDES, rows["fate"] == Fate.STRAYS
    assert collided.sum() >= 2
    assert lost.sum() >= 2
    for row in rows[collided]:
        (other,) = rows[
            (rows["road"] == row["road"])
            & (rows["step"] == row["step"])
            & (rows["vehicle"] == row["collided_with"])
        ]
        assert other["fate"] == Fate.COLLIDES
        later = (rows["road"] == row["road"]) & (rows["step"] > row["step"])
        assert not (rows["vehicle"][later] == row["vehicle"]).any()
    ended = rows[lost & (rows["command"] != NONE)]
    assert ended.size
    assert (ended["outcome"] == Outcome.OFF_ROAD).all()


def test_every_vehicle_is_there_in_each_step_of_its_life():
    rows = recordings.crashes().rows
    for road in np.unique(rows["road"]):
        here = rows[rows["road"] == road]
        for vehicle in np.unique(here["vehicle"]):
            steps = np.sort(here["step"][here["vehicle"] == vehicle])
            assert (np.diff(steps) == 1).all()


def test_without_a_note_before_the_step_nothing_wrong_is_told():
    """Vehicles removed meanwhile are missing, and so are actions; no number of another's."""
    simulator = started("five_lanes", 4, overrides=recordings.CROWDED)
    often, seldom = FrameReader(simulator), FrameReader(simulator)
    missing = 0
    for count, _ in enumerate(recordings.drive(simulator, 250, recordings.cross)):
        all_rows = often.read()
        if count % 3 == 0:
            few = seldom.read()
            if count == 0:
                continue
            stays = all_rows[all_rows["fate"] == Fate.STAYS]
            assert sorted(few[["road", "vehicle"]].tolist()) == sorted(
                stays[["road", "vehicle"]].tolist()
            )
            assert np.isnan(few["action_yaw_acceleration"]).all()
            missing += all_rows.size - stays.size
    assert missing > 0


def test_reading_changes_nothing():
    plain, read = started("interactive", 2), started("interactive", 2)
    reader = FrameReader(read)
    for _ in zip(recordings.drive(plain, 60), recordings.drive(read, 60), strict=True):
        reader.read()
    assert plain.snapshot() == read.snapshot()


def test_chosen_roads_are_read_as_they_are_among_all():
    simulator = started("paper", 4, first_road=10)
    all_roads, some = FrameReader(simulator), FrameReader(simulator, [3, 1])
    for _ in recordings.drive(simulator, 50):
        rows, chosen = all_roads.read(), some.read()
        wanted = rows[np.isin(rows["road"], [11, 13])]
        assert wanted.tobytes() == chosen.tobytes()


def test_frames_divide_the_rows_by_road():
    simulator = started("paper", 3)
    rows = FrameReader(simulator).read()
    frames = FrameReader(simulator).read_frames()
    assert [frame.road for frame in frames] == [0, 1, 2]
    assert sum(frame.rows.size for frame in frames) == rows.size
    assert all((frame.rows["road"] == frame.road).all() for frame in frames)
    assert frames[0].time == simulator.roads["step"][0] * 0.1


@pytest.mark.parametrize("road", [-1, 2])
def test_a_road_that_is_not_there_is_refused(road):
    with pytest.raises(ValueError, match=f"road = {road}: must be 0 to 1"):
        FrameReader(started("paper", 2), [road])


def test_followers_with_a_policy_have_their_actions_and_terms():
    scenario = load_scenario("dense", {"followers": {"mix": {"mine": 1.0}}})
    simulator = Simulator(
        scenario,
        2,
        follower_policies={"mine": lambda seen: np.full(len(seen), 0.25)},
        seed=0,
    )
    simulator.reset()
    reader = FrameReader(simulator)
    blocks = [reader.read() for _ in recordings.drive(simulator, 200)]
    rows = np.concatenate(blocks)
    acting = rows[np.isfinite(rows["follower_action"])]
    assert acting.size > 50
    assert (acting["follower_action"] == 0.25).all()
    terms = sum(acting[f"follower_{name}"] for name in FOLLOWER.reward_names)
    assert acting["follower_reward"] == pytest.approx(terms, abs=1e-6)
    assert (acting["disposition"] == 3).all()
