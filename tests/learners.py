"""Learners of changers and of followers on a tiny budget, and what they leave behind."""

import csv
from pathlib import Path

import torch
from collecting import BUSY
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf

from marl_lanes import LaneChangeEnv
from marl_lanes.training.checkpoint import make_follower_network, make_network
from marl_lanes.training.config import TrainingConfig, register
from marl_lanes.training.learner import Learner
from marl_lanes.training.run_folder import EVALUATED
from marl_lanes.training.transitions import LivePolicy

FOLDER = Path(__file__).parents[1] / "agents" / "naf"
TWO_ACTIONS = BUSY | {
    "action": {"longitudinal": {"max_acceleration": 1.0, "max_braking": 5.0}},
}
TINY = [
    "network.hidden_sizes=[8]",
    "collector.num_envs=8",
    "collector.steps_per_batch=10",
    "collector.total_transitions=300",
    "replay.warmup_transitions=32",
    "replay.batch_size=16",
    "optimizer.transitions_per_update=4",
    "optimizer.pretraining_transitions=100",
    "exploration.annealing_transitions=300",
    "evaluation.save_interval=120",
]


def tiny(*options):
    register("training_schema", TrainingConfig)
    with initialize_config_dir(str(FOLDER), version_base="1.3"):
        return OmegaConf.to_object(compose("config", [*TINY, *options]))


def changers(*options, overrides=BUSY, mu="damped", seed=0, **places):
    env = LaneChangeEnv("paper", 8, overrides=overrides, seed=seed)
    torch.manual_seed(seed)
    return Learner(tiny(*options), env, make_network(env.scenario, mu, [8]), **places)


def followers(*options, seed=0, **places):
    env = LaneChangeEnv("paper", 8, overrides=BUSY, seed=seed, learned_followers=True)
    torch.manual_seed(77)
    driver = make_network(env.scenario, "damped", [8])
    torch.manual_seed(seed)
    return Learner(
        tiny(*options),
        env,
        make_follower_network(env.scenario, [8]),
        group="followers",
        others=[LivePolicy(driver.policy().module, 1)],
        evaluated=("success_rate", "nothing"),
        **places,
    )


class Evaluation:
    """Counts the models that it is given; what it says of them depends on their weights."""

    def __init__(self):
        self.count = 0

    def __call__(self, network):
        self.count += 1
        quality = sum(value.sum().item() for value in network.state_dict().values())
        return dict.fromkeys(EVALUATED, quality) | {"nothing": None}


def rows(path):
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def tables(folder):
    names = ("metrics.csv", "maneuvers.csv", "evaluations.csv")
    return {name: (folder / name).read_bytes() for name in names}
