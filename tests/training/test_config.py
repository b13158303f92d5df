"""The configuration: complete in every recipe, typed, and within its ranges."""

import dataclasses
from pathlib import Path

import pytest
import torch
from hydra import compose, initialize_config_dir
from hydra.errors import ConfigCompositionException
from omegaconf import OmegaConf

from marl_lanes import LaneChangeEnv, load_scenario
from marl_lanes.training.checkpoint import make_network
from marl_lanes.training.config import (
    ConfigError,
    TrainingConfig,
    check,
    check_criterion,
    read_config,
    register,
    write_config,
)

FOLDER = Path(__file__).parents[2] / "agents" / "naf"
RECIPES = ["fast", "interactive", "paper"]


def resolve(*overrides):
    """What hydra makes of a command line."""
    register("training_schema", TrainingConfig)
    with initialize_config_dir(str(FOLDER), version_base="1.3"):
        return compose("config", list(overrides))


def typed(*overrides):
    return OmegaConf.to_object(resolve(*overrides))


def fields(kind=TrainingConfig, prefix=""):
    """Dotted names of every leaf field."""
    for field in dataclasses.fields(kind):
        if dataclasses.is_dataclass(field.type):
            yield from fields(field.type, f"{prefix}{field.name}.")
        else:
            yield prefix + field.name


@pytest.mark.parametrize("recipe", RECIPES)
def test_every_recipe_gives_every_field(recipe):
    given = resolve(f"recipe={recipe}")
    config = OmegaConf.to_object(given)
    assert isinstance(config, TrainingConfig)
    check(config)
    assert config.recipe == recipe
    names = list(fields())
    assert len(names) > 25
    for name in names:
        assert not OmegaConf.is_missing(OmegaConf.select(given, name.rpartition(".")[0]), name)
        OmegaConf.select(given, name, throw_on_missing=True)
    assert set(dataclasses.asdict(config)) == {field.name for field in dataclasses.fields(config)}


def test_the_recipes_on_the_folder_are_those_tested():
    assert sorted(path.stem for path in (FOLDER / "recipe").iterdir()) == RECIPES


def test_fast_is_the_default():
    assert typed() == typed("recipe=fast")
    assert typed() != typed("recipe=paper")


@pytest.mark.parametrize("recipe", RECIPES)
def test_the_recipes_overrides_fit_the_scenario(recipe):
    config = typed(f"recipe={recipe}")
    env = LaneChangeEnv(config.scenario, 1, overrides=config.training_overrides)
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


@pytest.mark.parametrize(
    ("override", "name", "value"),
    [
        ("loss.gamma=0.5", "loss.gamma", 0.5),
        ("loss.gamma=1", "loss.gamma", 1.0),
        ("seed=0", "seed", 0),
        ("initial_checkpoint=a/b.pt", "initial_checkpoint", "a/b.pt"),
        ("network.mu=damped", "network.mu", "damped"),
        ("network.hidden_sizes=[3]", "network.hidden_sizes", [3]),
        ("optimizer.max_gradient_norm=null", "optimizer.max_gradient_norm", None),
        ("optimizer.max_gradient_norm=2", "optimizer.max_gradient_norm", 2.0),
        ("optimizer.pretraining_transitions=0", "optimizer.pretraining_transitions", 0),
        ("exploration.initial_sigma=0.2", "exploration.initial_sigma", 0.2),
        ("+training_overrides.road.num_lanes=5", "training_overrides.road.num_lanes", 5),
    ],
)
def test_every_field_can_be_set(override, name, value):
    given = resolve(override)
    check(OmegaConf.to_object(given))
    found = OmegaConf.select(given, name)
    assert found == value
    assert type(found) is type(value) or isinstance(value, list)


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
    ("loss.gamma", -0.1),
    ("loss.gamma", 1.1),
    ("loss.gamma", "nan"),
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
    ("exploration.longitudinal_factor", 0.0),
    ("exploration.longitudinal_factor", "nan"),
    ("evaluation.save_interval", 0),
    ("evaluation.num_maneuvers", 0),
    ("evaluation.final_num_maneuvers", 0),
    ("evaluation.seed", -1),
]


@pytest.mark.parametrize(("name", "value"), BAD)
def test_what_is_out_of_range_is_named(name, value):
    config = typed(f"{name}={value}")
    with pytest.raises(ConfigError, match=rf"^{name} = .*: must be ") as caught:
        check(config)
    assert isinstance(caught.value, ValueError)
    assert str(value) in str(caught.value)


@pytest.mark.parametrize("name", ["cuda", "cuda:0", "mps", "meta", "nonsense", "cpu:1"])
def test_a_device_that_is_not_there_is_refused(monkeypatch, name):
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 0)
    with pytest.raises(ConfigError, match=rf"^device = '{name}': must be cpu, or cuda.* use, 0$"):
        check(typed(f"device='{name}'"))


def test_a_gpu_is_a_device(monkeypatch):
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 2)
    for name in ("cuda", "cuda:1", "cpu"):
        check(typed(f"device='{name}'"))
    with pytest.raises(ConfigError, match=r"device = 'cuda:2'.* 2$"):
        check(typed("device='cuda:2'"))


def test_a_criterion_is_a_metric_of_the_saved_models():
    for criterion in ("null", "quality"):
        check_criterion(typed(f"evaluation.criterion={criterion}"), ["quality"])
    message = r"^part.evaluation.criterion = 'beauty': must be null, quality, other$"
    with pytest.raises(ConfigError, match=message):
        check_criterion(typed("evaluation.criterion=beauty"), ["quality", "other"], "part.")


def test_a_resumed_run_has_its_own_config(tmp_path):
    config = typed("seed=3", "output=elsewhere", "+training_overrides.road.num_lanes=5")
    write_config(tmp_path / "run" / "config.yaml", config)
    found = read_config(resolve(f"resume={tmp_path / 'run'}", "seed=4"), TrainingConfig)
    path = str(tmp_path / "run")
    assert found == dataclasses.replace(config, output=path, resume=path)
    with pytest.raises(ConfigError, match=r"resume = .*absent.*must be a run folder"):
        read_config(resolve(f"resume={tmp_path / 'absent'}"), TrainingConfig)
    assert read_config(resolve("seed=3"), TrainingConfig).seed == 3


def test_a_field_without_a_value_is_named(tmp_path):
    path = tmp_path / "run" / "config.yaml"
    write_config(path, typed())
    path.write_text(path.read_text("utf-8").replace("  final_rate: 0.05\n", ""), encoding="utf-8")
    with pytest.raises(ConfigError, match=r"^optimizer.final_rate: must have .* resume = .*run'"):
        read_config(resolve(f"resume={tmp_path / 'run'}"), TrainingConfig)
    with pytest.raises(ConfigError, match=r"^optimizer.final_rate: .* the command line and its"):
        read_config(resolve("optimizer.final_rate='???'"), TrainingConfig)


def test_every_number_has_a_range():
    given = resolve("recipe=fast")
    values = {name: OmegaConf.select(given, name) for name in fields()}
    kinds = (int, float)
    numbers = {name for name, value in values.items() if type(value) in kinds}
    words = {"loss.target_update", "collector.kind", "replay.storage"}
    assert numbers == {name for name, _ in BAD} - words


@pytest.mark.parametrize("kind", ["single", "multi", "ray"])
def test_collector_is_chosen_by_one_word(kind):
    number = 1 if kind == "single" else 4
    config = typed(f"collector={kind}", f"num_workers={number}", "collector.num_envs=64")
    assert (config.collector.kind, config.num_workers) == (kind, number)
    assert config.collector.num_envs == 64
    assert config.collector.steps_per_batch == 16
    check(config)


def test_rays_address_is_an_option():
    config = typed("collector=ray", "num_workers=2", "ray.address=10.0.0.1:6379")
    assert config.ray.address == "10.0.0.1:6379"
    check(config)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["num_workers=2"], "num_workers = 2: must be 1 with collector=single"),
        (["ray.address=auto"], "ray.address = 'auto': must be null without ray"),
        (
            ["collector=multi", "num_workers=3"],
            "collector.num_envs = 256: must be a multiple of num_workers = 3",
        ),
    ],
)
def test_workers_that_do_not_fit_are_refused(options, message):
    with pytest.raises(ConfigError) as caught:
        check(typed(*options))
    assert str(caught.value) == message


@pytest.mark.parametrize(
    "override",
    ["nonsense=1", "loss.gama=0.9", "network.depth=3", "recipe=wild", "collector.envs=4"],
)
def test_unknown_keys_and_recipes_are_refused(override):
    with pytest.raises(ConfigCompositionException) as caught:
        resolve(override)
    unknown = override.split("=")[1 if override.startswith("recipe") else 0].split(".")[-1]
    assert unknown in f"{caught.value} {caught.value.__cause__}"


@pytest.mark.parametrize(
    "override",
    ["collector.num_envs=many", "loss.gamma=high", "seed=1.5", "network.hidden_sizes=[x]"],
)
def test_values_of_another_type_are_refused(override):
    with pytest.raises(ConfigCompositionException) as caught:
        resolve(override)
    name, value = override.split("=")
    text = f"{caught.value} {caught.value.__cause__}"
    assert value.strip("[]") in text
    assert name in text
