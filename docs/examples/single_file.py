"""PPO in one file, as CleanRL has it: a plain loop in which agents are born and end."""

import argparse

import numpy as np
import torch
from measuring import SCENARIO, TRAFFIC, Curve, add_options
from torch import nn
from torch.distributions import Normal

from marl_lanes import parallel_env

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--iterations", type=int, default=40, help="of 1024 steps of agents")
add_options(parser)
arguments = parser.parse_args()
torch.manual_seed(0)

GAMMA, LAMBDA, CLIP = 0.97, 0.95, 0.2
env = parallel_env(SCENARIO, normalised=True, overrides=TRAFFIC, seed=0)
num_features = env.observation_space("changer_0").shape[0]
num_actions = env.action_space("changer_0").shape[0]


def network(num_outputs):
    """Two hidden layers."""
    return nn.Sequential(
        nn.Linear(num_features, 64), nn.Tanh(), nn.Linear(64, 64), nn.Tanh(),
        nn.Linear(64, num_outputs),
    )  # fmt: skip


actor, critic = network(num_actions), network(1)
log_std = nn.Parameter(torch.full((num_actions,), -1.5))
parameters = [*actor.parameters(), *critic.parameters(), log_std]
optimizer = torch.optim.Adam(parameters, lr=1e-3)


@torch.no_grad()
def act(rows):
    """The policy's mean action for rows of live agents."""
    return actor(torch.as_tensor(rows)).clamp(-1.0, 1.0).numpy()


@torch.no_grad()
def collect(num_rows):
    """Whole episodes; each agent's life is a list of its own: rows and the value after its end."""
    lives, num_steps = [], 0
    while sum(len(rows) for rows, _ in lives) < num_rows:
        observations, _ = env.reset()
        open_lives = {}
        while env.agents:
            seen = torch.as_tensor(np.stack([observations[agent] for agent in env.agents]))
            chosen = Normal(actor(seen), log_std.exp())
            actions = chosen.sample()
            log_probs, values = chosen.log_prob(actions).sum(-1), critic(seen)[:, 0]
            acting = list(env.agents)
            num_steps += 1
            observations, rewards, terminations, truncations, _ = env.step(
                dict(zip(acting, actions.numpy(), strict=True))
            )
            for k, agent in enumerate(acting):
                row = (seen[k], actions[k], log_probs[k], values[k], rewards[agent])
                open_lives.setdefault(agent, []).append(row)
                if terminations[agent] or truncations[agent]:
                    last = critic(torch.as_tensor(observations[agent])).item()
                    lives.append((open_lives.pop(agent), 0.0 if terminations[agent] else last))
    return lives, num_steps


def advantages_of(values, rewards, last):
    """Generalised advantage estimates along one life."""
    found, running, after = torch.zeros(len(values)), 0.0, last
    for t in reversed(range(len(values))):
        running = rewards[t] + GAMMA * after - values[t] + GAMMA * LAMBDA * running
        found[t], after = running, values[t]
    return found


curve, num_taken = Curve(act, arguments), 0
for k in range(1, arguments.iterations + 1):
    columns = [[], [], [], [], []]
    lives, num_steps = collect(1024)
    for rows, last in lives:
        seen, actions, log_probs, values, rewards = zip(*rows, strict=True)
        advantages = advantages_of(values, rewards, last)
        targets = advantages + torch.stack(values)
        parts = (torch.stack(seen), torch.stack(actions), torch.stack(log_probs))
        for column, part in zip(columns, (*parts, advantages, targets), strict=True):
            column.append(part)
    seen, actions, log_probs, advantages, targets = map(torch.cat, columns)
    advantages = (advantages - advantages.mean()) / advantages.std()
    for _ in range(8):
        for part in torch.randperm(len(seen)).split(256):
            chosen = Normal(actor(seen[part]), log_std.exp())
            ratio = (chosen.log_prob(actions[part]).sum(-1) - log_probs[part]).exp()
            clipped = ratio.clamp(1.0 - CLIP, 1.0 + CLIP)
            gain = torch.minimum(ratio * advantages[part], clipped * advantages[part]).mean()
            error = (critic(seen[part])[:, 0] - targets[part]).square().mean()
            optimizer.zero_grad()
            (0.5 * error - gain).backward()
            nn.utils.clip_grad_norm_(parameters, 0.5)
            optimizer.step()
    num_taken += num_steps
    curve.reach(num_taken, k / arguments.iterations)
curve.end(num_taken)
