"""RLlib's PPO (new API stack): one policy for all agents, which are born and end in an episode."""

import argparse
import math

import numpy as np
import torch
from measuring import SCENARIO, TRAFFIC, Curve, add_options
from ray.rllib.algorithms.ppo import PPOConfig
from ray.rllib.core.rl_module.default_model_config import DefaultModelConfig

from marl_lanes.integrations.rllib import LaneChangeMultiAgentEnv

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--iterations", type=int, default=24, help="of 2048 steps of a road")
add_options(parser)
arguments = parser.parse_args()

NUM_STEPS = 2048

config = (
    PPOConfig()
    .environment(LaneChangeMultiAgentEnv, env_config={"scenario": SCENARIO, "overrides": TRAFFIC})
    .multi_agent(policies={"shared"}, policy_mapping_fn=lambda *_, **__: "shared")
    .rl_module(
        model_config=DefaultModelConfig(
            fcnet_hiddens=[64, 64], vf_share_layers=False, free_log_std=True
        )
    )
    .training(
        gamma=0.97,
        lambda_=0.95,
        lr=1e-3,
        grad_clip=0.5,
        # The default, 10, is of a squared error: where returns are -20, the critic learns nothing.
        vf_clip_param=math.inf,
        train_batch_size=NUM_STEPS,
        minibatch_size=256,
        num_epochs=8,
        use_kl_loss=False,
    )
    .env_runners(num_env_runners=0)
    .debugging(seed=0, log_level="ERROR")
)
algorithm = config.build_algo()
# A standard deviation of 1 would cover the whole range of actions.
for module in (algorithm.get_module("shared"), algorithm.learner_group._learner.module["shared"]):
    with torch.no_grad():
        for name, parameter in module.named_parameters():
            if "log_std" in name:
                parameter.fill_(-1.5)


def act(rows):
    """The policy's mean action for rows of live agents."""
    module = algorithm.get_module("shared")
    with torch.no_grad():
        found = module.forward_inference({"obs": torch.as_tensor(rows)})
    return np.clip(found["action_dist_inputs"][:, :1].numpy(), -1.0, 1.0)


curve = Curve(act, arguments)
for k in range(1, arguments.iterations + 1):
    algorithm.train()
    curve.reach(k * NUM_STEPS, k / arguments.iterations)
curve.end(arguments.iterations * NUM_STEPS)
algorithm.stop()
