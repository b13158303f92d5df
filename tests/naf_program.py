"""The training program, as a process and in this one, on a tiny budget."""

import os
import subprocess
import sys
from functools import partial
from pathlib import Path

import torch
from programs import BUSY, replaced

from marl_lanes import experiment
from marl_lanes.recipes.naf import make_algorithm, read

PROGRAM = Path(__file__).parents[1] / "agents" / "naf" / "train.py"
TINY = [
    "scenario=busy.yaml",
    "num_threads=1",
    "++training_overrides.warmup=[20.0,30.0]",
    "network.hidden_sizes=[8]",
    "collector.num_envs=8",
    "collector.steps_per_batch=4",
    "collector.total_transitions=300",
    "replay.warmup_transitions=64",
    "replay.batch_size=16",
    "optimizer.transitions_per_update=1",
    "optimizer.pretraining_transitions=120",
    "demonstrations.num_transitions=0",
    "evaluation.criterion=null",
    "evaluation.save_interval=100",
    "evaluation.num_maneuvers=2",
    "evaluation.final_num_maneuvers=3",
]

UNRECORDED = "evaluation.record=false"
"""For runs whose film and replays nobody looks at, which take most of their time."""


def prepare(folder):
    """The folder, with the scenario in it."""
    (folder / "busy.yaml").write_text(BUSY, encoding="utf-8")
    return folder


def read_tiny(*options):
    """What the program makes of the tiny budget and the options."""
    return read(replaced([*TINY, "output=run", *options]))


def begin(config):
    """A learner, as the program makes it."""
    return experiment.start(config, partial(make_algorithm, config), "train")[0]


def start(*options, folder, stderr=subprocess.PIPE):
    return subprocess.Popen(
        [sys.executable, str(PROGRAM), *replaced(options)],
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=stderr,
        text=True,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
        start_new_session=True,
    )


def run_program(*options, folder):
    process = start(*options, folder=folder)
    out, err = process.communicate(timeout=500)
    return process.returncode, out, err


def weights(run, name="final.pt"):
    return torch.load(run / "checkpoints" / name, weights_only=True)["weights"]


def assert_same_weights(one, other):
    assert one.keys() == other.keys()
    for key, value in one.items():
        assert torch.equal(other[key], value), key
