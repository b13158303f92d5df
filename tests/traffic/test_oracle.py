"""The kernel compared with the reference, which runs by itself, in drawn scenarios."""

from collections import Counter

import pytest
from drawn_scenarios import Drawn, drawn, share_of
from hypothesis import example, given
from oracle import follow_from_reset
from staging import MIXED

from marl_lanes.traffic.machine.state import CollisionKind, Outcome, Phase

NUM_STEPS = 300
EVERYTHING = {
    *(outcome.name for outcome in Outcome),
    *(phase.name for phase in Phase if phase != Phase.ABSENT),
    *(kind.name for kind in CollisionKind),
    *("paired", "scripted", "delay", "abort", "collision", "discomfort", "braking"),
    *("moving over", "moved over"),
}
"""What must occur in the whole of the drawn scenarios."""


def hold(number, *, is_whole):
    met = Counter()

    @share_of(number, is_whole=is_whole)
    @given(drawn())
    @example(Drawn({"command": {"position": [0.0, 0.0]}}))
    @example(Drawn({**MIXED, "vehicle": {"width": 2.0}}, seed=3, noise=0.4, bias=0.3))
    @example(Drawn({"command": {"position": [20.0, 80.0], "lanes": [0, 2, 4], "time_limit": 3.0}}))
    def compare(case):
        met.update(follow_from_reset(case, NUM_STEPS))
        met["cases"] += 1

    compare()
    assert met["cases"] >= number
    return met


def test_the_reference_alone_does_what_the_kernel_does():
    hold(5, is_whole=False)


@pytest.mark.long
def test_the_reference_alone_does_what_the_kernel_does_in_hundreds_of_scenarios():
    met = hold(300, is_whole=True)
    assert set(met) >= EVERYTHING, EVERYTHING - set(met)
