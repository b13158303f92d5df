"""The programs of agents/adversary with budgets of a second, and what they leave."""

import csv
import json
from pathlib import Path

import torch
from programs import BUSY

from marl_lanes import load_scenario
from marl_lanes.training.checkpoint import make_actor_network, make_network, save_checkpoint

FOLDER = Path(__file__).parents[1] / "agents" / "adversary"
SECTION = [
    "collector.num_envs=16",
    "collector.steps_per_batch=5",
    "collector.total_transitions=120",
    "replay.warmup_transitions=16",
    "replay.batch_size=8",
    "optimizer.transitions_per_update=4",
    "optimizer.pretraining_transitions=60",
    "evaluation.save_interval=50",
    "evaluation.num_maneuvers=2",
    "evaluation.final_num_maneuvers=4",
]
TINY = [
    "scenario=busy.yaml",
    "changer=changer.pt",
    "output=run",
    "training_overrides.warmup=[20.0,30.0]",
    "training_overrides.num_slots=4",
    "follower.hidden_sizes=[8]",
    *(f"follower.{option}" for option in SECTION),
]
PAPER = load_scenario("paper")
INPUTS = {"config.yaml", "scenario.yaml", "initial_changer.pt", "SHA256SUMS", ".lock"}
PHASE_FILES = {
    ".lock",
    "metrics.csv",
    "maneuvers.csv",
    "evaluations.csv",
    "training.json",
    "resume.pt",
    "checkpoints",
    "trajectories",
    "tensorboard",
}


def prepare(folder):
    """A scenario, a changer that finds its lane without training, and one of another form."""
    (folder / "busy.yaml").write_text(BUSY, encoding="utf-8")
    torch.manual_seed(0)
    save_checkpoint(folder / "changer.pt", make_network(PAPER, "damped", [8]), "busy", 0)
    save_checkpoint(folder / "actor.pt", make_actor_network(PAPER, [8]), "busy", 0)
    return folder


def rows(path):
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def names(folder):
    return {path.name for path in folder.iterdir()}


def weights(path):
    return torch.load(path, weights_only=True)["weights"]


def is_same(one, other):
    return all(torch.equal(value, other[key]) for key, value in one.items())


def read_json(path):
    return json.loads(path.read_text(encoding="utf-8"))


def pairs(path):
    """The statistics of a cross-play, by changer and follower."""
    found = read_json(path)["pairs"]
    return {(pair["changer"], pair["followers"]): pair["statistics"] for pair in found}
