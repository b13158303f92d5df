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
    assert task.state_spec(env)["state"].shape == (made.scenario.max_vehicles, 7)
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
