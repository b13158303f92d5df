"""Tianshou's PPO: each agent of a constant population is one of its parallel environments.

Its PettingZooEnv takes turns. Of a step's rewards the last agent's alone is then in a row of its
own, and the next observation of a row, which its value comes from, is another agent's. Here the
agents of a road act at once and share one policy.
"""

import argparse

import gymnasium
import numpy as np
import torch
from measuring import SCENARIO, TRAFFIC, Curve, add_options
from tianshou.algorithm import PPO
from tianshou.algorithm.modelfree.reinforce import ProbabilisticActorPolicy
from tianshou.algorithm.optim import AdamOptimizerFactory
from tianshou.data import Collector, VectorReplayBuffer
from tianshou.env import BaseVectorEnv
from tianshou.env.worker import DummyEnvWorker
from tianshou.trainer import OnPolicyTrainerParams
from tianshou.utils.net.common import Net
from tianshou.utils.net.continuous import ContinuousActorProbabilistic, ContinuousCritic
from torch.distributions import Independent, Normal

from marl_lanes import parallel_env

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--steps", type=int, default=16_384, help="of a road, for four agents")
add_options(parser)
arguments = parser.parse_args()
torch.manual_seed(0)
np.random.seed(0)  # noqa: NPY002 - Tianshou draws from it

NUM_STEPS = 512


class Road:
    """Moves, or is reset, when it has heard of all its agents."""

    def __init__(self):
        self.env = parallel_env(
            SCENARIO, population="constant", normalised=True, overrides=TRAFFIC, seed=0
        )
        self.actions, self.told = {}, ()

    def send(self, agent, action):
        self.actions[agent] = action
        if len(self.actions) == len(self.env.possible_agents):
            self.told = self.env.reset() if action is None else self.env.step(self.actions)
            self.actions = {}


class Place(gymnasium.Env):
    """An agent of a road."""

    def __init__(self, road, agent):
        self.road, self.agent = road, agent
        self.observation_space = road.env.observation_space(agent)
        self.action_space = road.env.action_space(agent)


class PlaceWorker(DummyEnvWorker):
    """Tianshou sends all actions, and then asks for what came of them."""

    def send(self, action, **_):
        self.env.road.send(self.env.agent, action)

    def recv(self):
        return tuple(part[self.env.agent] for part in self.env.road.told)


road = Road()
places = BaseVectorEnv(
    [lambda agent=agent: Place(road, agent) for agent in road.env.possible_agents], PlaceWorker
)
observation_space, action_space = places.observation_space[0], places.action_space[0]


def network():
    """Two hidden layers."""
    return Net(state_shape=observation_space.shape, hidden_sizes=[64, 64], activation=torch.nn.Tanh)


actor = ContinuousActorProbabilistic(
    preprocess_net=network(), action_shape=action_space.shape, unbounded=True
)
# A standard deviation of 1 would cover the whole range of actions.
actor.sigma_param.data.fill_(-1.5)
policy = ProbabilisticActorPolicy(
    actor=actor,
    dist_fn=lambda parts: Independent(Normal(*parts), 1),
    action_space=action_space,
)
learner = PPO(
    policy=policy,
    critic=ContinuousCritic(preprocess_net=network()),
    optim=AdamOptimizerFactory(lr=1e-3),
    gamma=0.97,
    ent_coef=0.0,
    max_grad_norm=0.5,
)


def act(rows):
    """The policy's mean action for rows of live agents, to which its flags are added."""
    flags = np.tile(np.float32([0.0, 1.0, 0.0]), (len(rows), 1))
    with torch.no_grad():
        (mean, _), _ = actor(np.hstack([rows, flags]))
    return mean.clamp(-1.0, 1.0).numpy()


curve = Curve(act, arguments)
num_rows = NUM_STEPS * len(places)
learner.run_training(
    OnPolicyTrainerParams(
        training_collector=Collector(policy, places, VectorReplayBuffer(num_rows, len(places))),
        max_epochs=arguments.steps // NUM_STEPS,
        epoch_num_steps=num_rows,
        collection_step_num_env_steps=num_rows,
        update_step_num_repetitions=10,
        batch_size=256,
        training_fn=lambda _, done: curve.reach(
            done // len(places), done / len(places) / arguments.steps
        ),
        show_progress=False,
        verbose=False,
    )
)
curve.end(arguments.steps)
