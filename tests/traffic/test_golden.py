"""The trajectories are equal to the recorded ones, in every field."""

import json
import os
import subprocess
import sys

import golden
import pytest

RECORDED = json.loads(golden.FILE.read_text(encoding="utf-8"))

pytestmark = pytest.mark.skipif(
    golden.fingerprint() != RECORDED["fingerprint"],
    reason="recorded on a machine where sin, cos or pow differ in the last bit",
)


def test_every_scenario_is_recorded():
    assert set(RECORDED["long"]) == set(RECORDED["short"]) == set(golden.SCENARIOS)


def assert_recorded(found, recorded):
    assert recorded.keys() <= found.keys()
    # A new term of a reward has the weight 0 here, and changes no trajectory.
    assert all(".terms." in field for field in found.keys() - recorded.keys())
    assert [field for field in recorded if found[field] != recorded[field]] == []


@pytest.mark.slow
@pytest.mark.parametrize("name", golden.SCENARIOS)
def test_trajectories_are_those_recorded(name):
    assert_recorded(golden.record(name, **golden.LONG), RECORDED["long"][name])


@pytest.mark.slow
def test_interpreted_kernels_give_the_same_trajectories():
    names = list(golden.SCENARIOS)

    result = subprocess.run(
        [sys.executable, golden.__file__, "short", *names],
        env={**os.environ, "NUMBA_DISABLE_JIT": "1"},
        capture_output=True,
        text=True,
        check=True,
    )

    found = json.loads(result.stdout)
    for name in names:
        assert_recorded(found[name], RECORDED["short"][name])


@pytest.mark.parametrize("name", golden.SCENARIOS)
def test_short_trajectories_are_those_recorded(name):
    assert_recorded(golden.record(name, **golden.SHORT), RECORDED["short"][name])
