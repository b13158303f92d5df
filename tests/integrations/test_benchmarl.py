"""BenchMARL's task: specs without the batch, and what is logged."""

import pytest
import torch
from tensordict import TensorDict

pytest.importorskip("benchmarl", reason="BenchMARL is not installed")
benchmarl = pytest.importorskip("marl_lanes.integrations.benchmarl")


def test_a_task_has_specs_of_one_road():
    from torchrl.envs import Compose, TransformedEnv

    config = {"scenario": "dense", "overrides": {"num_slots": 3}, "has_state": True}
    task = benchmarl.LaneChangeTask(config)
    made = task.get_env_fun(2, continuous_actions=True, seed=0, device="cpu")()
    env = TransformedEnv(made, Compose(*task.get_env_transforms(made)))
    assert task.observation_spec(env)["changers", "observation"].shape == (3, 6)
    assert task.action_spec(env)["changers", "action"].shape == (3, 1)
    # A vector, as BenchMARL's networks take it.
    assert task.state_spec(env)["state"].shape == (made.scenario.max_vehicles * 7,)
    assert list(task.group_map(env)) == ["changers"]
    assert not task.has_render(env)


def test_the_log_tells_of_the_commands_that_ended():
    after = TensorDict(
        {
            "done": torch.tensor([[[True]], [[True]], [[False]]]),
            "outcome": torch.tensor([[1], [2], [0]]),
            "command_reward": torch.tensor([[[-3.0]], [[-5.0]], [[-9.0]]]),
        },
        [3, 1],
    )
    told = benchmarl.LaneChangeTask.log_info(TensorDict({"next": {"changers": after}}, [3]))
    assert told == {"collection/commands/return": -4.0, "collection/commands/completed": 0.5}


@pytest.mark.training
@pytest.mark.filterwarnings("ignore:SyncDataCollector has been deprecated:DeprecationWarning")
@pytest.mark.filterwarnings("ignore:No episode terminated this iteration:UserWarning")
def test_a_centralised_critic_sees_the_state(tmp_path):
    from benchmarl.algorithms import MappoConfig
    from benchmarl.experiment import Experiment, ExperimentConfig
    from benchmarl.models.mlp import MlpConfig

    config = ExperimentConfig.get_from_yaml()
    config.max_n_iters, config.max_n_frames = 1, None
    config.on_policy_collected_frames_per_batch = config.on_policy_minibatch_size = 64
    config.on_policy_n_envs_per_worker, config.on_policy_n_minibatch_iters = 2, 1
    config.evaluation = config.render = config.create_json = False
    config.loggers, config.save_folder = [], tmp_path
    model = MlpConfig(num_cells=[8], layer_class=torch.nn.Linear, activation_class=torch.nn.Tanh)
    overrides = {"num_slots": 3, "num_agents": None, "horizon": None}
    task = {"scenario": "two_lanes", "overrides": overrides, "has_state": True}
    experiment = Experiment(
        task=benchmarl.LaneChangeTask(task),
        algorithm_config=MappoConfig.get_from_yaml(),
        model_config=model,
        seed=0,
        config=config,
    )
    size = experiment.test_env.base_env.scenario.max_vehicles * 7
    critic = experiment.losses["changers"].critic_network
    assert next(critic.parameters()).shape[-1] >= size
    experiment.run()
