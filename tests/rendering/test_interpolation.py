import numpy as np
import pytest

from marl_lanes import load_scenario
from marl_lanes.rendering.interpolation import Timeline
from marl_lanes.traffic.machine.state import Fate
from marl_lanes.trajectory.columns import new_rows
from marl_lanes.trajectory.frames import Frame

SCENARIO = load_scenario("paper")


def frame(step, **columns):
    rows = new_rows(len(next(iter(columns.values()))))
    rows["step"], rows["time"] = step, step * SCENARIO.time_step
    for name, values in columns.items():
        rows[name] = values
    return Frame(SCENARIO, 0, step, rows)


TWO = [
    frame(10, vehicle=[4, 7], position=[100.0, 50.0], lateral_position=[2.0, 5.0], lane=[0, 1]),
    frame(11, vehicle=[7, 9], position=[53.0, 1.0], lateral_position=[5.4, 2.0], lane=[2, 0]),
]


def test_a_vehicle_moves_evenly_between_two_steps():
    found = Timeline(TWO).at(1.025).rows
    assert found["vehicle"].tolist() == [4, 7]
    assert found["position"][1] == pytest.approx(50.75)
    assert found["lateral_position"][1] == pytest.approx(5.1)
    # Whole numbers and what a step did are those of the step before.
    assert found["lane"].tolist() == [0, 1]
    assert found["step"].tolist() == [10, 10]


def test_a_vehicle_that_the_next_step_does_not_have_stays_until_then():
    timeline = Timeline(TWO)
    assert timeline.at(1.099).rows["position"][0] == 100.0
    assert timeline.at(1.1).rows["vehicle"].tolist() == [7, 9]


@pytest.mark.parametrize(("time", "index"), [(-1.0, 0), (1.0, 0), (1.1, 1), (7.0, 1)])
def test_at_a_step_and_beyond_the_frames_are_the_given_ones(time, index):
    assert Timeline(TWO).at(time) is TWO[index]


def test_a_step_is_found_despite_rounding():
    frames = [frame(step, vehicle=[1], position=[float(step)]) for step in range(100)]
    timeline = Timeline(frames)
    for step in range(100):
        assert timeline.at(step / 3 * 0.1 * 3) is frames[step]


def test_a_gap_between_the_frames_is_passed_evenly():
    frames = [frame(step, vehicle=[1], position=[10.0 * step]) for step in (0, 4)]
    assert Timeline(frames).at(0.1).rows["position"][0] == pytest.approx(10.0)


def test_the_frames_are_not_changed():
    before = [one.rows.tobytes() for one in TWO]
    Timeline(TWO).at(1.05)
    assert [one.rows.tobytes() for one in TWO] == before


def test_a_timeline_needs_a_frame():
    with pytest.raises(ValueError, match="at least one frame"):
        Timeline([])


def test_a_removed_vehicle_is_still_there_in_the_step_that_removes_it():
    frames = [
        frame(0, vehicle=[1], position=[10.0], fate=[Fate.STAYS]),
        frame(1, vehicle=[1], position=[12.0], fate=[Fate.COLLIDES]),
        frame(2, vehicle=[2], position=[0.0], fate=[Fate.STAYS]),
    ]
    found = Timeline(frames).at(0.15).rows
    np.testing.assert_array_equal(found["position"], [12.0])
    assert found["fate"][0] == Fate.COLLIDES
