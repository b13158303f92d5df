"""The configuration: complete in every recipe, typed, and within its ranges."""

from typing import ClassVar

import pytest
import torch
from configs import FOLDER, resolve, select, typed
from pydantic import BaseModel

from marl_lanes import LaneChangeEnv, load_scenario
from marl_lanes.training.algorithms.naf import TrainingConfig
from marl_lanes.training.checkpoint import make_network
from marl_lanes.training.config import (
    ConfigError,
    EvaluationConfig,
    read_config,
    validate,
    write_config,
)

RECIPES = ["fast", "interactive", "long", "paper"]


def fields(kind=TrainingConfig, prefix=""):
    """Dotted names of every leaf field."""
    for name, field in kind.model_fields.items():
        inner = field.annotation
        if isinstance(inner, type) and issubclass(inner, BaseModel):
            yield from fields(inner, f"{prefix}{name}.")
        else:
            assert field.description, name
            yield prefix + name


@pytest.mark.parametrize("recipe", RECIPES)
def test_every_recipe_gives_every_field(recipe):
    given = resolve(f"recipe={recipe}")
    config = read_config(TrainingConfig, given)
    assert config.recipe == recipe
    names = list(fields())
    assert len(names) > 25
    for name in names:
        select(given, name)


def test_the_recipes_on_the_folder_are_those_tested():
    assert sorted(path.stem for path in (FOLDER / "recipe").iterdir()) == RECIPES


def test_fast_is_the_default():
    assert typed() == typed("recipe=fast")
    assert typed() != typed("recipe=paper")


@pytest.mark.parametrize("recipe", RECIPES)
def test_the_recipes_overrides_fit_the_scenario(recipe):
    config = typed(f"recipe={recipe}")
    env = LaneChangeEnv(config.scenario, 1, overrides=config.training_overrides, seed=0)
    # Collecting never waits for an episode's end, the evaluation has one.
    assert env.scenario.num_agents is None
    assert env.scenario.horizon is None
    assert load_scenario(config.scenario).num_agents is not None
    make_network(env.scenario, config.network.mu)


def test_the_scenario_may_be_another_than_the_recipes():
    config = typed("recipe=interactive", "scenario=paper", "network.mu=paper")
    assert (config.scenario, config.network.mu) == ("paper", "paper")


def test_the_paper_recipe_has_the_papers_numbers():
    config = typed("recipe=paper")
    assert config.loss.gamma == 0.95
    assert config.optimizer.learning_rate == 0.0005
    assert config.replay.batch_size == 64
    assert config.loss.target_update == "hard"
    assert config.loss.target_interval == 1000
    assert config.optimizer.pretraining_transitions == 200_000
    assert config.collector.total_transitions == 400_000
    assert (config.network.mu, config.replay.rare_share) == ("paper", 0.0)


BAD = [
    ("num_threads", 0),
    ("seed", -1),
    ("collector.num_envs", 0),
    ("collector.steps_per_batch", 0),
    ("collector.total_transitions", 0),
    ("collector.total_transitions", -5),
    ("collector.kind", "cloud"),
    ("num_workers", 0),
    ("replay.capacity", 0),
    ("replay.storage", "tape"),
    ("replay.batch_size", 0),
    ("replay.rare_share", -0.1),
    ("replay.rare_share", 1.0),
    ("replay.warmup_transitions", -1),
    ("demonstrations.policy", "quintic"),
    ("demonstrations.num_transitions", -1),
    ("demonstrations.num_rounds", 0),
    ("demonstrations.num_updates", 0),
    ("demonstrations.batch_size", 0),
    ("demonstrations.learning_rate", 0.0),
    ("demonstrations.sigma", -0.1),
    ("loss.gamma", -0.1),
    ("loss.gamma", 1.1),
    ("loss.gamma", "nan"),
    ("loss.num_steps", 0),
    ("loss.target_update", "firm"),
    ("loss.tau", 0.0),
    ("loss.tau", 1.5),
    ("loss.target_interval", 0),
    ("optimizer.learning_rate", 0.0),
    ("optimizer.learning_rate", -0.001),
    ("optimizer.mu_learning_rate", 0.0),
    ("optimizer.learning_rate", "nan"),
    ("optimizer.final_rate", 0.0),
    ("optimizer.final_rate", 1.1),
    ("optimizer.final_rate", "nan"),
    ("optimizer.max_gradient_norm", 0.0),
    ("optimizer.transitions_per_update", 0.0),
    ("optimizer.pretraining_transitions", -1),
    ("exploration.initial_sigma", -0.01),
    ("exploration.initial_sigma", "nan"),
    ("exploration.final_sigma", -0.01),
    ("exploration.final_sigma", 0.5),
    ("exploration.annealing_transitions", -1),
    ("exploration.probability", 0.0),
    ("exploration.probability", 1.1),
    ("exploration.longitudinal_factor", 0.0),
    ("exploration.longitudinal_factor", "nan"),
    ("evaluation.save_interval", 0),
    ("evaluation.num_maneuvers", 0),
    ("evaluation.final_num_maneuvers", 0),
    ("evaluation.seed", -1),
]


@pytest.mark.parametrize(("name", "value"), BAD)
def test_what_is_out_of_range_is_named(name, value):
    with pytest.raises(ConfigError, match=rf"^{name} = .*: must be ") as caught:
        typed(f"{name}={value}")
    assert isinstance(caught.value, ValueError)
    assert str(value) in str(caught.value)


@pytest.mark.parametrize("name", ["cuda", "cuda:0", "mps", "meta", "nonsense", "cpu:1"])
def test_a_device_that_is_not_there_is_refused(monkeypatch, name):
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 0)
    with pytest.raises(ConfigError, match=rf"^device = '{name}': must be cpu, or cuda.* use, 0$"):
        typed(f"device='{name}'")


def test_a_gpu_is_a_device(monkeypatch):
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 2)
    for name in ("cuda", "cuda:1", "cpu"):
        typed(f"device='{name}'")
    with pytest.raises(ConfigError, match=r"device = 'cuda:2'.* 2$"):
        typed("device='cuda:2'")


class OtherEvaluation(EvaluationConfig):
    metrics: ClassVar[tuple[str, ...]] = ("quality", "other")


class Part(BaseModel):
    part: OtherEvaluation


def test_a_criterion_is_a_metric_of_the_saved_models():
    given = resolve()["evaluation"]
    for criterion in (None, "quality"):
        validate(Part, {"part": given | {"criterion": criterion}})
    message = r"^part.criterion = 'success_rate': must be null, quality, other$"
    with pytest.raises(ConfigError, match=message):
        validate(Part, {"part": given | {"criterion": "success_rate"}})
    with pytest.raises(ConfigError, match=r"^evaluation.criterion = 'beauty': must be null, succ"):
        typed("evaluation.criterion=beauty")


def test_saved_models_are_evaluated_on_maneuvers_of_their_own():
    evaluation = typed().evaluation
    assert evaluation.saved_models_seed != evaluation.seed


def test_a_resumed_run_has_its_own_config(tmp_path):
    config = typed("seed=3", "output=elsewhere", "+training_overrides.road.num_lanes=5")
    write_config(tmp_path / "run" / "config.yaml", config)
    found = typed(f"resume={tmp_path / 'run'}")
    path = str(tmp_path / "run")
    assert found == config.model_copy(update={"output": path, "resume": path})
    with pytest.raises(ConfigError, match=r"resume = .*absent.*must be a run folder"):
        typed(f"resume={tmp_path / 'absent'}")
    assert typed("seed=3").seed == 3


def test_a_field_without_a_value_is_named(tmp_path):
    path = tmp_path / "run" / "config.yaml"
    write_config(path, typed())
    path.write_text(path.read_text("utf-8").replace("  final_rate: 0.05\n", ""), encoding="utf-8")
    resumed = f"resume={tmp_path / 'run'}"
    with pytest.raises(
        ConfigError, match=r"^resume = .*run'.* optimizer.final_rate: must be given"
    ):
        typed(resumed)
    path.write_text("seed: 0\nlerning_rate: [", encoding="utf-8")
    with pytest.raises(ConfigError, match=r"^resume = .*run': its config.yaml: not readable"):
        typed(resumed)
    path.write_text("[1, 2]", encoding="utf-8")
    with pytest.raises(ConfigError, match=r"^resume = .*run': its config.yaml: must be a mapping"):
        typed(resumed)
    with pytest.raises(ConfigError, match=r"^optimizer.final_rate = '\?\?\?': must be a valid"):
        typed("optimizer.final_rate='???'")


HUGE = [10**40, -(10**40), 1e308, -1e308, float("nan"), float("inf"), -float("inf"), True]


def test_every_number_has_a_range():
    given = resolve("recipe=fast")
    values = {name: select(given, name) for name in fields()}
    kinds = (int, float)
    numbers = {name for name, value in values.items() if type(value) in kinds}
    words = {"loss.target_update", "collector.kind", "replay.storage", "demonstrations.policy"}
    assert numbers == {name for name, _ in BAD} - words
    for name in sorted(numbers):
        *above, last = name.split(".")
        section = select(given, ".".join(above)) if above else given
        for value in HUGE:
            section[last] = value
            with pytest.raises(ConfigError, match=rf"\b{name} = .*: must be "):
                validate(TrainingConfig, given)
        section[last] = values[name]
    validate(TrainingConfig, given)


def test_a_training_that_would_never_learn_is_refused():
    message = r"^replay.warmup_transitions = 300: must be below collector.total_transitions = 300"
    with pytest.raises(ConfigError, match=message):
        typed("replay.warmup_transitions=300", "collector.total_transitions=300")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["num_workers=2"], "num_workers = 2: must be 1 with collector=single"),
        (["ray.address=auto"], "ray.address = 'auto': must be null without ray"),
        (
            ["collector=multi", "num_workers=3", "collector.num_envs=64"],
            "collector.num_envs = 64: must be a multiple of num_workers = 3",
        ),
    ],
)
def test_workers_that_do_not_fit_are_refused(options, message):
    with pytest.raises(ConfigError) as caught:
        typed(*options)
    assert str(caught.value) == message


@pytest.mark.parametrize(
    "override",
    ["collector.num_envs=many", "loss.gamma=high", "seed=1.5", "network.hidden_sizes=[x]"],
)
def test_values_of_another_type_are_refused(override):
    name, value = override.split("=")
    with pytest.raises(ConfigError, match=rf"^{name}.* = .*: must be a valid ") as caught:
        typed(override)
    assert value.strip("[]") in str(caught.value)
