"""TorchRL's PPO, collector and advantages on the batched environment, with nothing else of ours.

An agent's life is a slot's stretch between two ends: the group's own ends cut the advantages, and
the loss leaves out the rows in which no action has an effect.
"""

import argparse

import torch
from measuring import SCENARIO, TRAFFIC, Curve, add_options
from tensordict.nn import NormalParamExtractor, TensorDictModule
from torch import nn
from torchrl.collectors import Collector
from torchrl.modules import MLP, IndependentNormal, ProbabilisticActor, ValueOperator
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value import GAE

from marl_lanes import LaneChangeEnv
from marl_lanes.envs.transforms import normalise

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--iterations", type=int, default=25, help="of 128 steps on 16 roads")
add_options(parser)
arguments = parser.parse_args()
torch.manual_seed(0)

ENDLESS = {**TRAFFIC, "num_agents": None, "horizon": None, "num_slots": 4}
env = normalise(LaneChangeEnv(SCENARIO, 16, overrides=ENDLESS, seed=0))
seen = ("changers", "observation")
num_features = env.observation_spec[seen].shape[-1]
num_actions = env.full_action_spec["changers", "action"].shape[-1]
body = nn.Sequential(
    MLP(num_features, 2 * num_actions, num_cells=[64, 64]),
    NormalParamExtractor(scale_mapping="biased_softplus_0.2"),
)
parameters = [("changers", "loc"), ("changers", "scale")]
policy = ProbabilisticActor(
    TensorDictModule(body, [seen], parameters),
    in_keys={"loc": parameters[0], "scale": parameters[1]},
    out_keys=[("changers", "action")],
    distribution_class=IndependentNormal,
    distribution_kwargs={"tanh_loc": False},
    return_log_prob=True,
    log_prob_key=("changers", "sample_log_prob"),
)
critic = ValueOperator(
    MLP(num_features, 1, num_cells=[64, 64]), [seen], [("changers", "state_value")]
)
keys = {
    name: ("changers", name)
    for name in ("advantage", "value_target", "reward", "done", "terminated")
}
advantages = GAE(gamma=0.97, lmbda=0.95, value_network=critic)
advantages.set_keys(value=("changers", "state_value"), **keys)
loss = ClipPPOLoss(policy, critic, entropy_coeff=0.0, normalize_advantage=False)
loss.set_keys(
    action=("changers", "action"),
    sample_log_prob=("changers", "sample_log_prob"),
    value=("changers", "state_value"),
    **keys,
)
loss.loss_mask_key = ("changers", "acting")
optimizer = torch.optim.Adam(loss.parameters(), lr=1e-3)


def act(rows):
    """The policy's mean action for rows of live agents."""
    with torch.no_grad():
        return body(torch.as_tensor(rows))[0].clamp(-1.0, 1.0).numpy()


num_frames = 16 * 128
num_steps = arguments.iterations * num_frames
curve = Curve(act, arguments)
collector = Collector(
    env,
    policy,
    frames_per_batch=num_frames,
    total_frames=num_steps,
    track_traj_ids=False,
    auto_register_policy_transforms=False,
)
for k, batch in enumerate(collector, 1):
    with torch.no_grad():
        advantages(batch)
        # Over the rows that count: the others have values of nobody.
        is_acting = batch["changers", "acting"].unsqueeze(-1)
        of_agents = batch[keys["advantage"]]
        chosen = of_agents[is_acting]
        batch[keys["advantage"]] = (of_agents - chosen.mean()) / chosen.std()
    rows = batch.reshape(-1)
    for _ in range(8):
        for part in torch.randperm(len(rows)).split(len(rows) // 4):
            parts = loss(rows[part])
            total = parts["loss_objective"] + parts["loss_critic"]
            optimizer.zero_grad()
            total.backward()
            nn.utils.clip_grad_norm_(loss.parameters(), 1.0)
            optimizer.step()
    collector.update_policy_weights_()
    curve.reach(k * num_frames, k / arguments.iterations)
curve.end(num_steps)
