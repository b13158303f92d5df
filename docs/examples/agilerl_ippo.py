"""AgileRL's IPPO with a constant population, whose agents share one policy.

IPPO of AgileRL 2.58 sorts the observations of agents that share by agent, and their advantages by
time: it can learn from one agent alone. So the agents of a road are parallel environments of one.
It also squeezes the (N, 1) actions of a batch, and its Gaussian then adds up the log-probabilities
of all N. So an action has a second number, which the road does not see.
"""

import argparse

import numpy as np
import torch
from agilerl.algorithms import IPPO
from agilerl.training.train_multi_agent_on_policy import train_multi_agent_on_policy
from agilerl.vector.pz_vec_env import PettingZooVecEnv
from gymnasium.spaces import Box
from measuring import NUM_POINTS, SCENARIO, TRAFFIC, Curve, add_options

from marl_lanes import parallel_env

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--steps", type=int, default=16_384, help="of a road, for four agents")
add_options(parser)
arguments = parser.parse_args()
torch.manual_seed(0)
np.random.seed(0)  # noqa: NPY002 - AgileRL draws from it

NAME, NUM_STEPS = "changer", 512


class Places(PettingZooVecEnv):
    """The agents of a road, side by side; the road begins anew when its episode has ended."""

    def __init__(self):
        self.road = parallel_env(
            SCENARIO, population="constant", normalised=True, overrides=TRAFFIC, seed=0
        )
        agents = self.road.possible_agents
        seen, acts = self.road.observation_space(agents[0]), Box(-1.0, 1.0, (2,))
        super().__init__(len(agents), {NAME: seen}, {NAME: acts}, [NAME])

    def reset(self, *, seed=None, options=None):
        observations, _ = self.road.reset(seed=seed, options=options)
        return gathered(observations), {NAME: {}}

    def step(self, actions):
        chosen = dict(zip(self.road.agents, actions[NAME][:, :1], strict=True))
        observations, rewards, terminations, truncations, _ = self.road.step(chosen)
        if not self.road.agents:
            observations, _ = self.road.reset()
        # An update moves values by 0.2 at most, as it does the policy's ratio: they must be small.
        rewards = {agent: reward / 10.0 for agent, reward in rewards.items()}
        parts = observations, rewards, terminations, truncations
        return *map(gathered, parts), {NAME: {}}


def gathered(part):
    """The values of all agents as those of one, in parallel environments."""
    return {NAME: np.stack(list(part.values()))}


places = Places()
learner = IPPO(
    [places.single_observation_space(NAME)],
    [places.single_action_space(NAME)],
    agent_ids=[NAME],
    learn_step=NUM_STEPS * places.num_envs,
    batch_size=256,
    update_epochs=8,
    gamma=0.97,
    lr=1e-3,
    ent_coef=0.0,
    net_config={"encoder_config": {"hidden_size": [64, 64]}},
)
actor = learner.actors[NAME]
# action_std_init is a logarithm, and 0, the least that IPPO takes, would cover the whole range.
actor.head_net.log_std.data.fill_(-1.5)


def act(rows):
    """The policy's mean action for rows of live agents, to which its flags are added."""
    flags = np.tile(np.float32([0.0, 1.0, 0.0]), (len(rows), 1))
    with torch.no_grad():
        actor(torch.as_tensor(np.hstack([rows, flags])))
    return actor.head_net.dist.mu[:, :1].clamp(-1.0, 1.0).numpy()


curve = Curve(act, arguments)
for k in range(1, NUM_POINTS + 1):
    num_steps = arguments.steps * k // NUM_POINTS
    train_multi_agent_on_policy(
        places,
        "marl_lanes",
        "IPPO",
        [learner],
        max_steps=num_steps * places.num_envs,
        evo_steps=NUM_STEPS * places.num_envs,
        verbose=False,
    )
    curve.reach(num_steps, k / NUM_POINTS)
curve.end(arguments.steps)
