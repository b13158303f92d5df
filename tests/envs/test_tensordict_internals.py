"""A step's tensordicts are the same without what tensordict and TorchRL do not promise."""

import importlib.util

import pytest
import torch
from tensordict import TensorDict

from marl_lanes import LaneChangeEnv
from marl_lanes.envs import tensordict_internals


def load_anew():
    spec = importlib.util.spec_from_file_location("anew", tensordict_internals.__file__)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_name_is_looked_for(monkeypatch):
    assert load_anew()._make == TensorDict._new_unsafe
    for kind in TensorDict.__mro__:
        if "_new_unsafe" in vars(kind):
            monkeypatch.delattr(kind, "_new_unsafe")
    assert load_anew()._make is TensorDict


def rollout(device):
    env = LaneChangeEnv(
        "dense",
        2,
        device=device,
        overrides={"warmup": [20.0, 20.0]},
        learned_followers=True,
        seed=0,
    )
    return env.rollout(30, break_when_any_done=False)


@pytest.mark.parametrize("device", [None, "cpu"])
def test_a_rollout_without_the_names(device, monkeypatch):
    torch.manual_seed(0)
    expected = rollout(device)
    monkeypatch.setattr(tensordict_internals, "_make", TensorDict)
    monkeypatch.delattr(LaneChangeEnv, "_step_proc_data")
    torch.manual_seed(0)
    found = rollout(device)
    assert found.device == expected.device
    assert set(found.keys(True, True)) == set(expected.keys(True, True))
    for key, value in expected.items(True):
        if isinstance(value, torch.Tensor):
            assert torch.equal(found[key], value), key
            assert found[key].dtype == value.dtype, key
        else:
            assert found[key].batch_size == value.batch_size, key
            assert found[key].device == value.device, key
    assert expected["changers", "mask"].any()
