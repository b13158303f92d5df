"""Learners of changers and of followers on a tiny budget, and what they leave behind."""

import csv
from pathlib import Path

import torch
from collecting import BUSY
from programs import replaced
from tensordict import TensorDict

from marl_lanes import LaneChangeEnv
from marl_lanes.traffic.roles.follower import FOLLOWER
from marl_lanes.training.algorithms.naf import NAF, TrainingConfig
from marl_lanes.training.checkpoint import make_network
from marl_lanes.training.command_line import compose_fields
from marl_lanes.training.config import EVALUATED, EvaluationConfig, read_config
from marl_lanes.training.learner import Learner
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


class OtherEvaluation(EvaluationConfig):
    metrics = ("success_rate", "nothing")


class OtherConfig(TrainingConfig):
    evaluation: OtherEvaluation


def tiny(*options, kind=TrainingConfig):
    return read_config(kind, compose_fields(kind, FOLDER, replaced([*TINY, *options])))


def changers(*options, overrides=BUSY, mu="damped", seed=0, **places):
    env = LaneChangeEnv("paper", 8, overrides=overrides, seed=seed)
    torch.manual_seed(seed)
    config = tiny(*options)
    return Learner(config, env, NAF(config, env, make_network(env.scenario, mu, [8]), **places))


def followers(*options, seed=0, **places):
    env = LaneChangeEnv("paper", 8, overrides=BUSY, seed=seed, learned_followers=True)
    torch.manual_seed(77)
    driver = make_network(env.scenario, "damped", [8])
    torch.manual_seed(seed)
    config = tiny(*options, kind=OtherConfig)
    network = make_network(env.scenario, "mlp", [8], role=FOLLOWER)
    algorithm = NAF(config, env, network, group="followers", **places)
    return Learner(config, env, algorithm, others=[LivePolicy(driver.policy().module, 1)])


class Evaluation:
    """Counts the models that it is given; what it says of them depends on their weights."""

    def __init__(self):
        self.count = 0
        self.recorded = []

    def __call__(self, network, recorded):
        self.count += 1
        self.recorded.append(recorded)
        quality = sum(value.sum().item() for value in network.state_dict().values())
        return dict.fromkeys(EVALUATED, quality) | {"nothing": None}


def rows(path):
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def tables(folder):
    names = ("metrics.csv", "maneuvers.csv", "evaluations.csv")
    return {name: (folder / name).read_bytes() for name in names}


def filled(folder, *options):
    """A learner with transitions in its replay buffer."""
    learner = changers(*options)
    learner.begin(folder)
    generator = torch.Generator().manual_seed(3)

    def draw(*shape):
        return torch.randn(shape, generator=generator)

    ends = {key: draw(200, 1) > 1.5 for key in ("done", "terminated", "truncated")}
    following = TensorDict({"observation": draw(200, 6), "reward": draw(200, 1), **ends}, [200])
    rows = {"observation": draw(200, 6), "action": draw(200, 1) * 0.1, "next": following}
    learner.experience.extend(TensorDict(rows, [200]))
    return learner


def weights_of(learner):
    """A copy of the networks' weights."""
    return {key: value.clone() for key, value in learner.algorithm.loss.state_dict().items()}
