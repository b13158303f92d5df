"""Threads that share a road: alone on the CPU, and as a team what one thread does."""

import json
import os
import subprocess
import sys
from pathlib import Path

import golden
import numpy as np
import pytest
from gpu_compiler import compile_ptx

from marl_lanes.traffic.machine.compiled import compiled
from marl_lanes.traffic.machine.team import (
    any_member,
    is_team,
    least,
    meet,
    member,
    most,
    team_size,
)

PROGRAM = Path(golden.__file__).with_name("road_teams.py")
RECORDED = json.loads(golden.FILE.read_text(encoding="utf-8"))

MEETINGS = """
import sys
sys.path.insert(0, sys.argv[1])
import road_teams
from marl_lanes.traffic.machine import team

def everywhere():
    total = 0
    for number in range(3):
        total += team.most(team.member() + number) + team.least(team.member())
    return total + team.any_member(team.member() == 1)

def elsewhere():
    if team.member() == 0:
        team.meet()
    else:
        team.meet()

def leaving():
    if team.member() > 0:
        team.meet()

crew = team.crew = road_teams.Crew(4, "random")
found = []
road_teams.run = lambda work: found.append(work())
crew.run(everywhere)
assert found == [3 + 4 + 5 + 1] * 4, found
for work in elsewhere, leaving:
    work.__code__ = work.__code__.replace(co_filename="marl_lanes/" + work.__name__)
    try:
        crew.run(work)
    except road_teams.TeamError as error:
        print(error)
"""


def gather(numbers, found):
    start = member()
    total, is_negative = 0.0, False
    for index in range(start, numbers.shape[0], team_size()):
        total += numbers[index]
        is_negative = is_negative or numbers[index] < 0.0
    meet()
    found[0] = least(total)
    found[1] = most(total)
    found[2] = 1.0 if any_member(is_negative) else 0.0
    found[3] = 1.0 if is_team() else 0.0


ARGUMENTS = np.array([1.0, -2.0, 4.0]), np.empty(4)


@pytest.mark.slow
def test_on_the_cpu_a_thread_is_alone():
    numbers, found = ARGUMENTS
    compiled(gather)(numbers, found)
    assert found.tolist() == [3.0, 3.0, 1.0, 0.0]
    compiled(gather)(abs(numbers), found)
    assert found.tolist() == [7.0, 7.0, 0.0, 0.0]


@pytest.mark.slow
def test_on_a_gpu_members_meet_vote_and_exchange(monkeypatch):
    ptx = compile_ptx(gather, ARGUMENTS, monkeypatch)
    # A vote is a meeting, too; a number has two halves.
    numbers = [ptx.count(name) for name in ("bar.warp.sync", "vote.sync.any", "shfl.sync.bfly")]
    assert numbers == [2, 1, 4]
    assert "%tid.x" in ptx
    assert "%ntid.x" in ptx


def test_members_that_do_not_find_together_are_told():
    done = subprocess.run(
        [sys.executable, "-c", MEETINGS, str(PROGRAM.parent)],
        env={**os.environ, "NUMBA_DISABLE_JIT": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    elsewhere, leaving = done.stdout.splitlines()
    assert "'elsewhere'" in elsewhere
    assert "left" in leaving


@pytest.mark.slow
@pytest.mark.parametrize(
    ("size", "order", "names"),
    [
        (8, "random", list(golden.SCENARIOS)),
        (2, "last", ["hasty", "interactive", "learned", "mixed", "yielding"]),
        (32, "first", ["dense", "interactive", "learned", "mixed"]),
        (1, "first", ["interactive"]),
    ],
)
@pytest.mark.skipif(
    golden.fingerprint() != RECORDED["fingerprint"],
    reason="recorded on a machine where sin, cos or pow differ in the last bit",
)
def test_a_team_does_what_one_thread_does(size, order, names):
    done = subprocess.run(
        [sys.executable, str(PROGRAM), str(size), order, *names],
        env={**os.environ, "NUMBA_DISABLE_JIT": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found["num_meetings"] > 1000 * len(names)
    for name in names:
        recorded, digests = RECORDED["short"][name], found["digests"][name]
        assert [field for field in recorded if digests[field] != recorded[field]] == []
