"""A training from its configuration to its report: what is refused, and how it can end."""

import types

import pytest
from configs import typed

from marl_lanes import ScenarioError, experiment
from marl_lanes.training.collectors import WorkerError
from marl_lanes.training.config import ConfigError


def make_nothing(*_):
    pytest.fail("an algorithm was made")


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        (["scenario=nope"], ScenarioError, "scenario 'nope': no such scenario"),
        (
            ["training_overrides.command.probability=0.0"],
            ConfigError,
            "training_overrides: command.probability = 0: must be above 0",
        ),
        (
            ["+training_overrides.road.num_lanes=1"],
            ConfigError,
            "training_overrides: scenario 'paper': road.num_lanes = 1: must be ",
        ),
        (
            ["collector.num_envs=1_000_000_000"],
            ValueError,
            "collector.num_envs = 1000000000: needs",
        ),
    ],
)
def test_what_cannot_be_trained_is_refused_before_a_file_is_written(
    tmp_path, options, error, message
):
    with pytest.raises(error) as caught:
        experiment.start(typed(f"output={tmp_path / 'run'}", *options), make_nothing, "train")
    assert message in str(caught.value)
    assert list(tmp_path.iterdir()) == []


def test_a_scenario_without_an_end_is_refused(tmp_path):
    file = tmp_path / "endless.yaml"
    file.write_text("num_agents: null\nhorizon: null\n", encoding="utf-8")
    with pytest.raises(ValueError, match="num_agents"):
        experiment.start(
            typed(f"output={tmp_path / 'run'}", f"scenario={file}"), make_nothing, "train"
        )
    assert list(tmp_path.iterdir()) == [file]


def test_a_folder_with_files_is_refused(tmp_path):
    (tmp_path / "notes.txt").write_text("mine", encoding="utf-8")
    with pytest.raises(ConfigError, match="must be a new or empty folder"):
        experiment.start(typed(f"output={tmp_path}"), make_nothing, "train")
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]


class Ending:
    """A learner that ends in a given way as soon as it trains."""

    def __init__(self, folder, end):
        self.run = types.SimpleNamespace(path=folder)
        self.collector = types.SimpleNamespace(places=["process 7 on a host"])
        self.end = end
        self.num_closed = 0

    def train(self, evaluate):
        assert callable(evaluate)
        return self.end()

    def close(self):
        self.num_closed += 1


def test_an_interrupted_training_says_how_to_go_on(tmp_path, capsys):
    learner = Ending(tmp_path, lambda: False)
    experiment.run(learner, None, None)
    out, err = capsys.readouterr()
    assert out == f"interrupted; continue with resume={tmp_path}\n"
    assert err == "worker 0: process 7 on a host\n"
    assert learner.num_closed == 1


def test_a_dead_worker_ends_the_program_with_one_line(tmp_path):
    def die():
        raise WorkerError("worker 0 of 1 has died")

    learner = Ending(tmp_path, die)
    with pytest.raises(SystemExit) as caught:
        experiment.run(learner, None, None)
    assert caught.value.code == (
        f"error: worker 0 of 1 has died; continue from the last training state: resume={tmp_path}"
    )
    assert learner.num_closed == 1


def test_any_other_error_closes_the_learner_too(tmp_path):
    def fail():
        raise KeyError("fault")

    learner = Ending(tmp_path, fail)
    with pytest.raises(KeyError, match="fault"):
        experiment.run(learner, None, None)
    assert learner.num_closed == 1
