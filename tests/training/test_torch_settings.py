"""What a caller has set in torch, and its thread, change nothing of a training."""

import threading
from contextlib import contextmanager
from types import SimpleNamespace

import pytest
import torch
from learners import Evaluation, changers, tables, weights_of

from marl_lanes import load_scenario
from marl_lanes.naf.mu import STRUCTURES
from marl_lanes.training.checkpoint import (
    load_policy,
    make_actor_network,
    make_network,
    save_checkpoint,
)
from marl_lanes.training.torch_settings import take_resources, training_settings

collector_warnings = pytest.mark.filterwarnings(
    "ignore:Creating .* which inherits from WeightUpdaterBase:DeprecationWarning"
)
SCENARIOS = {1: load_scenario("paper"), 2: load_scenario("interactive")}


@contextmanager
def doubles():
    torch.set_default_dtype(torch.float64)
    try:
        yield
    finally:
        torch.set_default_dtype(torch.float32)


@contextmanager
def deterministic():
    torch.use_deterministic_algorithms(True)
    try:
        yield
    finally:
        torch.use_deterministic_algorithms(False)


@pytest.mark.parametrize("mu", [*STRUCTURES, "actor"])
def test_networks_are_float32_and_the_same(mu, tmp_path):
    scenario = SCENARIOS[2 if "+" in mu else 1]

    def make():
        torch.manual_seed(3)
        if mu == "actor":
            return make_actor_network(scenario, [8])
        return make_network(scenario, mu, [8])

    wanted = make().state_dict()
    with doubles():
        network = make()
        save_checkpoint(tmp_path / "x.pt", network, "paper", 1)
        loaded = load_policy(tmp_path / "x.pt", scenario).network
        for found in (network.state_dict(), loaded.state_dict()):
            assert all(found[key].dtype == value.dtype for key, value in wanted.items())
            assert all(torch.equal(found[key], value) for key, value in wanted.items())


def trained(folder, made_in, trained_in):
    """The tables and the weights of a training."""
    with made_in():
        learner = changers("evaluation.save_interval=1000")
    learner.begin(folder)
    with trained_in():
        assert learner.train(Evaluation())
    learner.close()
    return tables(folder), weights_of(learner)


@contextmanager
def nothing():
    yield


def in_bfloat16():
    return torch.autocast("cpu")


@pytest.mark.filterwarnings("ignore:.*CUDA is not available:UserWarning")
def test_convolutions_on_a_gpu_are_exact_in_a_training_alone():
    cudnn = torch.backends.cudnn
    before = cudnn.deterministic, cudnn.allow_tf32, cudnn.enabled
    with training_settings(torch.device("cuda")):
        assert (cudnn.deterministic, cudnn.allow_tf32, cudnn.enabled) == (True, False, True)
    assert (cudnn.deterministic, cudnn.allow_tf32, cudnn.enabled) == before


@pytest.mark.parametrize("device", ["cpu", "cuda", "cuda:1"])
def test_threads_and_a_gpu_with_a_number_are_taken(device, monkeypatch):
    taken = []
    monkeypatch.setattr(torch, "set_num_threads", taken.append)
    monkeypatch.setattr(torch.cuda, "set_device", taken.append)
    config = SimpleNamespace(num_threads=3, device=device)
    assert take_resources(config) == torch.device(device)
    assert taken == [3, *([torch.device("cuda:1")] if device == "cuda:1" else [])]


@pytest.mark.training
@collector_warnings
def test_a_training_is_the_same_whatever_is_set(tmp_path):
    reference = trained(tmp_path / "reference", nothing, nothing)
    for name, made_in, trained_in in (
        ("float64", doubles, doubles),
        ("no_grad", torch.no_grad, torch.no_grad),
        ("inference", nothing, torch.inference_mode),
        ("autocast", in_bfloat16, in_bfloat16),
        ("deterministic", deterministic, deterministic),
    ):
        found = trained(tmp_path / name, made_in, trained_in)
        assert found[0] == reference[0], name
        for key, value in reference[1].items():
            assert torch.equal(found[1][key], value), (name, key)
    results = []

    def train():
        results.append(trained(tmp_path / "thread", nothing, nothing))

    thread = threading.Thread(target=train)
    thread.start()
    thread.join()
    assert results
    assert results[0][0] == reference[0]
