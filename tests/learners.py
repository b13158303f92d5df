"""Learners of changers and of followers on a tiny budget, and what they leave behind."""

import csv
import shutil
from functools import partial
from pathlib import Path

import torch
from collecting import BUSY
from programs import replaced
from tensordict import TensorDict

from marl_lanes import LaneChangeEnv
from marl_lanes.recipes import FOLDER
from marl_lanes.traffic.roles.follower import FOLLOWER
from marl_lanes.training.algorithms.ddpg import DDPG, DDPGConfig
from marl_lanes.training.algorithms.naf import NAF, TrainingConfig
from marl_lanes.training.algorithms.ppo import PPO, PPOConfig
from marl_lanes.training.algorithms.sac import SAC, SACConfig
from marl_lanes.training.algorithms.td3 import TD3, TD3Config
from marl_lanes.training.checkpoint import make_actor_network, make_network
from marl_lanes.training.collectors import LocalCollector
from marl_lanes.training.command_line import compose_fields
from marl_lanes.training.config import EVALUATED, EvaluationConfig, read_config, validate
from marl_lanes.training.learner import Learner
from marl_lanes.training.transitions import LivePolicy

BASELINES_FOLDER = Path(__file__).parents[1] / "agents" / "baselines"
BASELINES = {
    "ippo": (PPOConfig, PPO),
    "mappo": (PPOConfig, partial(PPO, is_centralised=True)),
    "sac": (SACConfig, SAC),
    "td3": (TD3Config, TD3),
    "ddpg": (DDPGConfig, DDPG),
}
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
    "demonstrations.num_transitions=0",
    "evaluation.criterion=null",
    "exploration.annealing_transitions=300",
    "evaluation.save_interval=120",
]


class OtherEvaluation(EvaluationConfig):
    metrics = ("success_rate", "nothing")


class OtherConfig(TrainingConfig):
    evaluation: OtherEvaluation


def tiny(*options, kind=TrainingConfig):
    return read_config(kind, compose_fields(kind, FOLDER, replaced([*TINY, *options])))


def changers(
    *options,
    overrides=BUSY,
    mu="damped",
    seed=0,
    roads="cpu",
    make_collector=LocalCollector,
    **places,
):
    env = LaneChangeEnv("paper", 8, overrides=overrides, seed=seed, device=roads)
    torch.manual_seed(seed)
    config = tiny(*options)
    algorithm = NAF(config, env, make_network(env.scenario, mu, [8]), **places)
    return Learner(config, env, algorithm, make_collector=make_collector)


def followers(*options, seed=0, **places):
    env = LaneChangeEnv("paper", 8, overrides=BUSY, seed=seed, learned_followers=True)
    torch.manual_seed(77)
    driver = make_network(env.scenario, "damped", [8])
    torch.manual_seed(seed)
    config = tiny(*options, kind=OtherConfig)
    network = make_network(env.scenario, "mlp", [8], role=FOLLOWER)
    algorithm = NAF(config, env, network, group="followers", **places)
    return Learner(config, env, algorithm, others=[LivePolicy(driver.policy().module, 1)])


def baseline(name, *options, overrides=BUSY, seed=0, **places):
    """A learner with one of the algorithms of agents/baselines."""
    kind, algorithm = BASELINES[name]
    absent = [] if name in {"td3", "ddpg"} else ["exploration"]
    absent += ["replay", "optimizer.transitions"] if "ppo" in name else []
    absent += ["optimizer.pretraining", "demonstrations"]
    tiny = [option for option in TINY if not option.startswith(tuple(absent))]
    tiny += ["epochs.batch_size=16"] if "ppo" in name else []
    fields = compose_fields(kind, BASELINES_FOLDER, replaced([*tiny, *options]), file=name)
    del fields["collector"]["kind"]
    config = validate(kind, {field: fields[field] for field in kind.model_fields})
    env = LaneChangeEnv("paper", 8, overrides=overrides, seed=seed, has_state=name == "mappo")
    torch.manual_seed(seed)
    network = make_actor_network(env.scenario, config.network.hidden_sizes)
    return Learner(config, env, algorithm(config, env, network, **places))


def transitions(algorithm, count=64):
    """Made-up ones, in the features' and actions' units."""
    box, normalise = algorithm.network.box, algorithm.network.normalise
    shape = (count, len(algorithm.network.features))
    terminated, truncated = (torch.rand(count, 1) > 0.7 for _ in range(2))
    truncated &= ~terminated
    return TensorDict(
        {
            "observation": torch.randn(shape) * normalise.scale + normalise.offset,
            "action": box.low + (box.high - box.low) * torch.rand(count, box.low.numel()),
            "next": {
                "observation": torch.randn(shape) * normalise.scale + normalise.offset,
                "reward": torch.randn(count, 1),
                "terminated": terminated,
                "truncated": truncated,
                "done": terminated | truncated,
            },
        },
        [count],
    )


def state(algorithm):
    """A copy of all parameters and targets."""
    return {key: value.clone() for key, value in algorithm.loss.state_dict().items()}


def is_changed(before, after, part):
    """Whether a network of the loss has other weights."""
    keys = [key for key in before if key.startswith(f"{part}_network_params.") and "layers" in key]
    assert keys
    return any(not torch.equal(before[key], after[key]) for key in keys)


def check_resuming(folder, make):
    """A training that is resumed in its middle ends as one that goes through.

    Args:
        folder: for both.
        make: a learner of a seed.

    Returns:
        the rows of its metrics.
    """
    one = make(seed=0)
    one.begin(folder / "one")
    assert one.train(Crash(folder / "one", folder / "other"))
    other = make(seed=9)
    other.resume(folder / "other")
    assert 0 < other.transitions < one.transitions
    assert other.train(Evaluation())
    for learner in (one, other):
        learner.close()
    assert tables(folder / "one") == tables(folder / "other")
    for key, value in state(one.algorithm).items():
        assert torch.equal(state(other.algorithm)[key], value), key
    return rows(folder / "one" / "metrics.csv")


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


class Crash(Evaluation):
    """Copies the run folder in the middle of the training."""

    def __init__(self, run, copy):
        super().__init__()
        self.run, self.copy = run, copy

    def __call__(self, network, recorded):
        if self.count == 1:
            shutil.copytree(self.run, self.copy)
        return super().__call__(network, recorded)


def rows(path):
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def tables(folder):
    names = ("metrics.csv", "maneuvers.csv", "evaluations.csv")
    return {name: (folder / name).read_bytes() for name in names}


def filled(folder, *options, **places):
    """A learner with transitions in its replay buffer."""
    learner = changers(*options, **places)
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
