"""How a training fails: divergence, idleness, and what the program says at its end."""

import math
import sys

import pytest
import torch
from learners import Evaluation, changers, filled, rows
from tensordict import TensorDict

from marl_lanes import ScenarioError, load_scenario
from marl_lanes.training import failures
from marl_lanes.training.collectors import WorkerError
from marl_lanes.training.config import OptimizerConfig
from marl_lanes.training.failures import (
    STATUS_INTERRUPTED,
    IdleWatch,
    TrainingError,
    check_losses,
    check_weights,
    ending,
    explain_divergence,
)
from marl_lanes.training.resume import read_state

NAN, INF = math.nan, math.inf
SAVE_OFTEN = "evaluation.save_interval=70"
collector_warnings = pytest.mark.filterwarnings(
    "ignore:Creating .* which inherits from WeightUpdaterBase:DeprecationWarning"
)


@pytest.mark.parametrize(
    ("losses", "message"),
    [
        ({"loss": [1.0, NAN, NAN]}, "update 9: loss = nan: must be finite"),
        ({"loss": [INF]}, "update 10: loss = inf: must be finite"),
        ({"loss": [1.0, 2.0], "actor_loss": [-INF]}, "update 9 to 10: actor_loss = -inf: must "),
    ],
)
def test_the_first_loss_that_is_not_finite_is_named(losses, message):
    with pytest.raises(TrainingError) as caught:
        check_losses(losses, 10)
    assert str(caught.value).startswith(message)


def test_losses_that_are_finite_pass():
    check_losses({"loss": [1e30, -1e30, 0.0], "actor_loss": []}, 10)
    check_losses({}, 0)


def optimizer_of(*values):
    """Adam after a step on two parameters, whose weights and means are then set."""
    parameters = [torch.nn.Parameter(torch.ones(3)) for _ in range(2)]
    optimizer = torch.optim.Adam([{"params": [one]} for one in parameters], fused=True)
    sum(one.sum() for one in parameters).backward()
    optimizer.step()
    with torch.no_grad():
        for one, value in zip(parameters, values, strict=False):
            one[1] = value
    return optimizer


@pytest.mark.parametrize("value", [NAN, INF, -INF, 1e30, -1e7])
def test_weights_of_no_network_that_learns(value):
    check_weights(optimizer_of(5.0, -99.0), 7)
    for values in ((value,), (0.0, value)):
        with pytest.raises(TrainingError, match=r"^update 7: the largest weight is .*: must be at"):
            check_weights(optimizer_of(*values), 7)


@pytest.mark.parametrize("key", ["exp_avg", "exp_avg_sq"])
@pytest.mark.parametrize("value", [NAN, INF])
def test_a_mean_that_stops_every_weight(key, value):
    optimizer = optimizer_of()
    state = optimizer.state[optimizer.param_groups[1]["params"][0]]
    state[key][2] = value
    with pytest.raises(TrainingError, match=r"^update 7: a mean of the gradients is (nan|inf): "):
        check_weights(optimizer, 7)


def test_what_may_help_is_named():
    config = OptimizerConfig(learning_rate=0.5, final_rate=1.0, max_gradient_norm=None)
    message = str(explain_divergence(TrainingError("update 3: loss = nan"), config))
    assert message.startswith("update 3: loss = nan; ")
    assert "optimizer.learning_rate = 0.5, optimizer.max_gradient_norm = None" in message


@pytest.mark.training
@collector_warnings
@pytest.mark.parametrize("rate", ["optimizer.learning_rate", "optimizer.mu_learning_rate"])
def test_a_training_that_diverges_stops_at_that_update(tmp_path, rate):
    """Its files are from before, and are whole; resumed, it ends likewise."""
    options = [f"{rate}=1e30", "optimizer.pretraining_transitions=150", SAVE_OFTEN]
    learner = changers(*options)
    learner.begin(tmp_path / "run")
    with pytest.raises(TrainingError, match=rf"^update \d+: .*{rate} = 1e\+30") as caught:
        learner.train(Evaluation())
    learner.close()
    metrics = rows(tmp_path / "run" / "metrics.csv")
    assert 0 < len(metrics) < 20
    losses = [float(row["loss"]) for row in metrics if row["loss"]]
    assert all(map(math.isfinite, losses))
    kept = read_state(tmp_path / "run" / "resume.pt")["loss"]
    saved = list((tmp_path / "run" / "checkpoints").iterdir())
    models = [torch.load(path, weights_only=True)["weights"] for path in saved]
    assert all(value.isfinite().all() for one in (kept, *models) for value in one.values())
    assert not (tmp_path / "run" / "checkpoints" / "final.pt").exists()
    assert bool(saved) == ("mu" in rate)
    again = changers(*options)
    again.resume(tmp_path / "run")
    with pytest.raises(TrainingError) as second:
        again.train(Evaluation())
    again.close()
    assert str(second.value) == str(caught.value)


@pytest.mark.training
@collector_warnings
def test_a_gradient_that_is_not_finite_is_seen(tmp_path):
    learner = filled(tmp_path / "run")
    take_step, zero = learner.algorithm.take_step, learner.algorithm.gradients[0]

    def spoiled(batch, number):
        found = take_step(batch, number)
        if number == 5:
            zero[0] = NAN
            learner.algorithm.optimizer.step()
        return found

    learner.algorithm.take_step = spoiled
    losses = {name: values.tolist() for name, values in learner.update(4).items()}
    learner.check(losses)
    losses = {name: values.tolist() for name, values in learner.update(1).items()}
    with pytest.raises(TrainingError, match=r"^update 5: the largest weight is nan"):
        learner.check(losses)
    learner.close()


@pytest.mark.training
@collector_warnings
@pytest.mark.parametrize("value", [NAN, INF])
def test_a_metric_that_is_not_finite_is_seen(tmp_path, value):
    learner = changers()
    learner.begin(tmp_path / "run")

    def evaluate(network, recorded):
        return Evaluation()(network, recorded) | {"success_rate": value}

    with pytest.raises(TrainingError, match=r"^step_0\d+.pt: success_rate = (nan|inf): must be f"):
        learner.train(evaluate)
    learner.close()
    assert rows(tmp_path / "run" / "evaluations.csv") == []


def steps(num_steps, *, has_commands):
    mask = torch.zeros(8, num_steps, 4, dtype=torch.bool)
    mask[3, num_steps - 1, 2] = has_commands
    return TensorDict({"changers": {"mask": mask}}, [8, num_steps])


@pytest.mark.parametrize(
    ("has_commands", "message"),
    [
        (False, r"no vehicle is commanded; command.probability = 0.333.*horizon = 120.0 too short"),
        (True, r"vehicles are commanded, but none engages; .* gap.rule = car_following"),
    ],
)
def test_idleness_ends_the_training(has_commands, message):
    watch = IdleWatch(load_scenario("paper", {"time_step": 0.25, "horizon": 120.0}))
    # 36,000 s on 8 roads are 4,500 s, 18,000 steps.
    watch.note(steps(17_999, has_commands=True), 0)
    watch.note(steps(1, has_commands=False), 1)
    watch.note(steps(16_000, has_commands=has_commands), 0)
    watch.note(steps(1999, has_commands=False), 0)
    with pytest.raises(TrainingError, match=r"^in 4500 s on 8 roads .* transition: " + message):
        watch.note(steps(1, has_commands=False), 0)


@pytest.mark.training
@collector_warnings
def test_a_training_in_which_nobody_acts_ends(tmp_path, monkeypatch):
    monkeypatch.setattr(failures, "IDLE_TIME", 3.0)
    monkeypatch.setattr(failures, "IDLE_ROAD_TIME", 0.0)
    idle = {"num_agents": None, "horizon": None, "command": {"probability": 1e-9}}
    learner = changers(overrides=idle)
    learner.begin(tmp_path / "run")
    with pytest.raises(TrainingError, match=r"^in \d+ s on 8 roads .* command.probability = 1e-09"):
        learner.train(Evaluation())
    learner.close()


@pytest.mark.parametrize(
    ("error", "wanted"),
    [
        (WorkerError("died: w"), "error: died: w; continue from the last training state: resume=r"),
        (OSError(28, "No space"), "error: [Errno 28] No space; continue from the last training s"),
        (TrainingError("it\ndiverges"), "error: it diverges"),
        (ScenarioError("ends before"), "error: ends before"),
    ],
)
def test_a_failure_is_one_line_and_status_1(error, wanted):
    with pytest.raises(SystemExit) as caught, ending("r"):
        raise error
    # A text as the status: Python writes it to stderr and ends with 1.
    assert caught.value.code.startswith(wanted)
    assert len(caught.value.code.splitlines()) == 1


def test_a_second_interruption_is_one_line(capsys):
    with pytest.raises(SystemExit) as caught, ending("r"):
        raise KeyboardInterrupt
    assert caught.value.code == STATUS_INTERRUPTED
    said = "interrupted at once; continue from the last training state: resume=r\n"
    assert capsys.readouterr() == ("", said)


def test_a_fault_of_the_program_keeps_its_traceback():
    assert "marl_lanes" in sys.modules
    with pytest.raises(ZeroDivisionError), ending("r"):
        raise ZeroDivisionError
