"""The newest saved model of a run."""

import json
import os
import shutil

import numpy as np
import pytest
import torch
from checkpoints import LONGITUDINAL, PAPER, trained

from marl_lanes.browser.models import FixedModel, Model, RunModels
from marl_lanes.scenario import ScenarioError
from marl_lanes.training.checkpoint import save_checkpoint
from marl_lanes.training.config import ConfigError

torch.set_num_threads(1)


@pytest.fixture
def run(tmp_path):
    """The folder of a run that has not saved a model yet."""
    folder = tmp_path / "run"
    (folder / "checkpoints").mkdir(parents=True)
    fields = json.dumps(PAPER.model_dump(mode="json"))
    (folder / "scenario.yaml").write_text(fields, encoding="utf-8")
    return folder


class Saving:
    """Saves models, each a second after the one before by the clock of the files."""

    def __init__(self, folder):
        self.folder = folder / "checkpoints"
        self.seconds = 1_000_000

    def save(self, name, transitions, network=None):
        path = self.folder / name
        save_checkpoint(path, network or trained(), "paper", transitions)
        self.stamp(path)

    def stamp(self, path):
        self.seconds += 1
        os.utime(path, (self.seconds, self.seconds))


@pytest.fixture
def saving(run):
    return Saving(run)


@pytest.fixture
def warnings():
    return []


@pytest.fixture
def models(run, warnings):
    return RunModels(run, None, warn=warnings.append)


def names(model):
    """File name and transitions of its label."""
    path, transitions = model.label.removesuffix(" transitions").split(", ")
    run, _, name = path.partition("/")
    assert run == "run"
    return name, transitions


def test_there_is_none_before_the_first_is_saved(run, models, saving, warnings):
    assert models.scenario == PAPER
    assert models.find_newest() is None
    assert str(run) in models.waiting
    saving.save("step_000001000.pt", 1000)
    assert names(models.find_newest()) == ("step_000001000.pt", "1,000")
    assert warnings == []
    assert models.trouble is None


def test_the_one_with_most_transitions_is_the_newest(models, saving):
    saving.save("step_000020000.pt", 20000)
    saving.save("step_000003000.pt", 3000)
    assert names(models.find_newest())[0] == "step_000020000.pt"
    first = models.find_newest()
    assert models.find_newest() is first
    saving.save("step_000100000.pt", 100000)
    assert names(models.find_newest()) == ("step_000100000.pt", "100,000")


def test_an_older_one_that_changes_does_not_drive(models, saving):
    saving.save("step_000001000.pt", 1000)
    saving.save("step_000002000.pt", 2000)
    newest = models.find_newest()
    saving.save("step_000001000.pt", 1000)
    assert models.find_newest() is newest
    # Nor is it taken for a newer one when that has gone.
    (saving.folder / "step_000002000.pt").unlink()
    assert models.find_newest() is newest


def test_the_final_one_is_the_newest_until_the_run_goes_on(models, saving):
    saving.save("step_000001000.pt", 1000)
    saving.save("step_000002000.pt", 2000)
    saving.save("final.pt", 1000)
    assert names(models.find_newest()) == ("final.pt", "1,000")
    saving.save("step_000003000.pt", 3000)
    assert names(models.find_newest())[0] == "step_000003000.pt"
    saving.save("final.pt", 3000)
    assert names(models.find_newest()) == ("final.pt", "3,000")


def test_the_model_drives(models, saving):
    network = trained()
    saving.save("final.pt", 5, network)
    seen = np.random.default_rng(0).normal(size=(3, len(network.features))).astype(np.float32)
    actions = models.find_newest().policy(seen)
    expected = network.policy().module(torch.from_numpy(seen)).detach().numpy()
    assert np.allclose(actions, expected)
    assert np.abs(actions).max() > 0.0


@pytest.mark.parametrize("content", [b"", b"half a file", None], ids=["empty", "text", "half"])
def test_a_broken_file_is_passed_over_until_it_is_whole(models, saving, warnings, content):
    saving.save("step_000001000.pt", 1000)
    first = models.find_newest()
    saving.save("step_000002000.pt", 2000)
    path = saving.folder / "step_000002000.pt"
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2] if content is None else content)
    saving.stamp(path)
    for _ in range(3):
        assert models.find_newest() is first
        assert "step_000002000.pt" in models.trouble
    assert len(warnings) == 1
    assert warnings[0] == models.trouble
    assert "\n" not in warnings[0]
    path.write_bytes(whole)
    saving.stamp(path)
    assert names(models.find_newest())[0] == "step_000002000.pt"
    assert models.trouble is None
    assert len(warnings) == 1


def test_one_that_is_broken_stays_a_trouble_until_a_newer_one_drives(models, saving, warnings):
    path = saving.folder / "step_000002000.pt"
    path.write_bytes(b"broken")
    assert models.find_newest() is None
    saving.save("step_000001000.pt", 1000)
    assert names(models.find_newest())[0] == "step_000001000.pt"
    assert str(path) in models.trouble
    saving.save("step_000003000.pt", 3000)
    assert names(models.find_newest())[0] == "step_000003000.pt"
    assert models.trouble is None
    assert len(warnings) == 1


def test_of_broken_ones_the_next_drives(models, saving, warnings):
    saving.save("step_000001000.pt", 1000)
    for name in ("step_000002000.pt", "final.pt"):
        (saving.folder / name).write_bytes(b"broken")
        saving.stamp(saving.folder / name)
    assert names(models.find_newest())[0] == "step_000001000.pt"
    assert len(warnings) == 2
    assert "final.pt" in models.trouble


def test_a_deleted_folder_leaves_the_last_model(run, models, saving, warnings):
    saving.save("final.pt", 7)
    last = models.find_newest()
    shutil.rmtree(run)
    for _ in range(2):
        assert models.find_newest() is last
    assert warnings == [f"{run}: the run folder is gone"]
    assert models.trouble == warnings[0]
    (run / "checkpoints").mkdir(parents=True)
    saving.save("final.pt", 8)
    assert names(models.find_newest()) == ("final.pt", "8")
    assert models.trouble is None


def test_a_model_of_another_scenario_is_passed_over(run, saving, warnings):
    saving.save("final.pt", 7)
    models = RunModels(run, LONGITUDINAL, warn=warnings.append)
    assert models.find_newest() is None
    assert len(warnings) == 1
    assert "final.pt" in warnings[0]


@pytest.mark.parametrize(
    ("text", "error", "message"),
    [
        (None, ConfigError, "has no scenario.yaml"),
        ("a: [", ScenarioError, "not readable as YAML"),
        ("[1, 2]", ScenarioError, "must be a mapping of fields"),
        ("num_agents: x", ScenarioError, "scenario.yaml: num_agents = 'x': "),
    ],
)
def test_a_folder_that_is_none_of_a_run_is_refused(tmp_path, text, error, message):
    if text is not None:
        (tmp_path / "scenario.yaml").write_text(text, encoding="utf-8")
    with pytest.raises(error, match=message):
        RunModels(tmp_path, None, warn=print)


def test_a_fixed_model_stays():
    model = Model("x", np.zeros_like)
    models = FixedModel(model)
    assert models.find_newest() is model
    assert models.trouble is None
