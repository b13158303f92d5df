"""BenchMARL's algorithms, one after the other."""

import argparse
import tempfile
from dataclasses import asdict

import torch
from benchmarl.algorithms import IddpgConfig, Ippo, IppoConfig, MappoConfig, MasacConfig
from benchmarl.experiment import Callback, Experiment, ExperimentConfig
from benchmarl.models.mlp import MlpConfig
from measuring import SCENARIO, TRAFFIC, Curve, add_options
from tensordict import TensorDict
from torchrl.envs.utils import ExplorationType, set_exploration_type

from marl_lanes.integrations.benchmarl import LaneChangeTask

ALGORITHMS = {
    "ippo": IppoConfig,
    "mappo": MappoConfig,
    "iddpg": IddpgConfig,
    "masac": MasacConfig,
}
parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--algorithms", nargs="+", choices=ALGORITHMS, default=list(ALGORITHMS))
parser.add_argument("--iterations", type=int, default=25, help="of 2048 steps of a road")
add_options(parser)
arguments = parser.parse_args()

NUM_SLOTS, NUM_STEPS = 4, 2048


def configure(folder):
    """BenchMARL's settings with which a minute is enough to see something."""
    config = ExperimentConfig.get_from_yaml()
    config.max_n_iters, config.max_n_frames = arguments.iterations, None
    config.gamma, config.lr, config.clip_grad_val = 0.97, 1e-3, 1.0
    config.on_policy_collected_frames_per_batch = NUM_STEPS
    config.off_policy_collected_frames_per_batch = NUM_STEPS
    config.on_policy_n_envs_per_worker = config.off_policy_n_envs_per_worker = 16
    config.on_policy_n_minibatch_iters, config.on_policy_minibatch_size = 8, 512
    config.off_policy_n_optimizer_steps, config.off_policy_train_batch_size = 64, 128
    config.off_policy_memory_size = 50_000
    config.evaluation = config.render = config.create_json = False
    config.loggers, config.save_folder = [], folder
    return config


class ActingIppo(Ippo):
    """IPPO whose policy learns from the rows in which an agent acts; the others are of nobody."""

    def process_batch(self, group, batch):
        batch = super().process_batch(group, batch)
        is_acting = batch[group, "acting"].unsqueeze(-1)
        of_agents = batch[group, "advantage"]
        chosen = of_agents[is_acting]
        scaled = (of_agents - chosen.mean()) / chosen.std()
        batch[group, "advantage"] = torch.where(is_acting, scaled, 0.0)
        return batch


class ActingIppoConfig(IppoConfig):
    """Names the class."""

    @staticmethod
    def associated_class():
        return ActingIppo


class Measuring(Callback):
    """Measures on the way."""

    def on_train_end(self, *_):
        done = self.experiment.n_iters_performed + 1
        curve.reach(done * NUM_STEPS, done / arguments.iterations)


def policy_of(experiment):
    """The mean action for rows of live agents, a full set of slots at a time."""

    def act(rows):
        actions = []
        for part in torch.as_tensor(rows).split(NUM_SLOTS):
            slots = torch.zeros(1, NUM_SLOTS, part.shape[-1])
            slots[0, : len(part)] = part
            seen = TensorDict({"changers": TensorDict({"observation": slots}, [1, NUM_SLOTS])}, [1])
            with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
                actions.append(experiment.policy(seen)["changers", "action"][0, : len(part)])
        return torch.cat(actions).numpy()

    return act


endless = {**TRAFFIC, "num_agents": None, "horizon": None, "num_slots": NUM_SLOTS}
for name in arguments.algorithms:
    algorithm = ALGORITHMS[name].get_from_yaml()
    if hasattr(algorithm, "scale_mapping"):
        # A standard deviation of 1 would cover the whole range of actions. Without the second
        # number, the least, it shrinks to 0.02, and every update throws the policy about.
        algorithm.scale_mapping = "biased_softplus_0.2_0.1"
    if hasattr(algorithm, "lmbda"):
        algorithm.lmbda = 0.95
    if name == "ippo":
        algorithm = ActingIppoConfig(**asdict(algorithm))
    with tempfile.TemporaryDirectory() as folder:
        experiment = Experiment(
            task=LaneChangeTask({"scenario": SCENARIO, "overrides": endless}),
            algorithm_config=algorithm,
            model_config=MlpConfig(
                num_cells=[64, 64], layer_class=torch.nn.Linear, activation_class=torch.nn.Tanh
            ),
            seed=0,
            config=configure(folder),
            callbacks=[Measuring()],
        )
        act = policy_of(experiment)
        curve = Curve(act, arguments, f"{name}, ")
        experiment.run()
        curve.end(arguments.iterations * NUM_STEPS)
