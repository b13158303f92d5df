"""Roads in the computer's memory: calls of many steps."""

from marl_lanes import Simulator
from marl_lanes.traffic import host


def test_the_steps_of_a_call_are_bounded_and_their_number_changes_nothing(monkeypatch):
    states = []
    for work in (1, host._WORK_PER_CALL):
        monkeypatch.setattr(host, "_WORK_PER_CALL", work)
        simulator = Simulator("paper", 3, seed=3)
        calls, roads = [], simulator._roads
        run = roads._run
        monkeypatch.setattr(roads, "_run", lambda *a, run=run, calls=calls: calls.append(run(*a)))
        simulator.reset()
        simulator.advance_until_live()
        states.append(simulator.state.tobytes())
        assert len(calls) > 40 if work == 1 else len(calls) == 3
    assert states[0] == states[1]
