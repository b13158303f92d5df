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


@pytest.mark.slow
@pytest.mark.parametrize("name", golden.SCENARIOS)
def test_trajectories_are_those_recorded(name):
    found = golden.record(name, **golden.LONG)

    recorded = RECORDED["long"][name]
    assert found.keys() == recorded.keys()
    assert [field for field in found if found[field] != recorded[field]] == []


@pytest.mark.slow
def test_interpreted_kernels_give_the_same_trajectories():
    names = ["learned", "mixed", "curved"]

    result = subprocess.run(
        [sys.executable, golden.__file__, "short", *names],
        env={**os.environ, "NUMBA_DISABLE_JIT": "1"},
        capture_output=True,
        text=True,
        check=True,
    )

    assert json.loads(result.stdout) == {name: RECORDED["short"][name] for name in names}
