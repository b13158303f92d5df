"""Stable-Baselines3's PPO by way of SuperSuit, with a constant population."""

import argparse

import numpy as np
import supersuit
from measuring import SCENARIO, TRAFFIC, Curve, add_options
from stable_baselines3 import PPO
from stable_baselines3.common.utils import set_random_seed

from marl_lanes import parallel_env

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--timesteps", type=int, default=60_000, help="rows, absent ones included")
add_options(parser)
arguments = parser.parse_args()

NUM_AGENTS = TRAFFIC["num_agents"]

road = parallel_env(SCENARIO, population="constant", normalised=True, overrides=TRAFFIC)
agents = supersuit.pettingzoo_env_to_vec_env_v1(road)
roads = supersuit.concat_vec_envs_v1(agents, 4, base_class="stable_baselines3")
# PPO(seed=...) would ask for a method that SuperSuit's vector environment lacks.
roads.venv.reset(seed=0)
set_random_seed(0)
model = PPO(
    "MlpPolicy",
    roads,
    n_steps=256,
    batch_size=512,
    gamma=0.97,
    learning_rate=1e-3,
    policy_kwargs={"log_std_init": -1.5},
    device="cpu",
)


def act(rows):
    """The policy's mean action for rows of live agents, to which its flags are added."""
    flags = np.tile(np.float32([0.0, 1.0, 0.0]), (len(rows), 1))
    return model.predict(np.hstack([rows, flags]), deterministic=True)[0]


def note(here, _):
    """Measure on the way; True goes on."""
    done = here["self"].num_timesteps
    curve.reach(done // NUM_AGENTS, done / arguments.timesteps)
    return True


curve = Curve(act, arguments)
model.learn(arguments.timesteps, callback=note)
curve.end(model.num_timesteps // NUM_AGENTS)
