"""Overrides: what they may name, and what is refused instead of being ignored."""

import pytest
from configs import FOLDER

from marl_lanes.training.algorithms.naf import TrainingConfig
from marl_lanes.training.config import ConfigError
from marl_lanes.training.overrides import check_overrides

UNKNOWN = [
    ("nonsense=1", "nonsense: unknown key; allowed: scenario, "),
    ("loss.gama=0.9", "loss.gama: unknown key; did you mean gamma? allowed: gamma, "),
    ("+loss.gama=0.9", "loss.gama: unknown key; did you mean gamma? allowed: gamma, "),
    ("++loss.gama=0.9", "loss.gama: unknown key; did you mean gamma? allowed: gamma, "),
    ("loss={gama:0.9}", "loss.gama: unknown key; did you mean gamma? allowed: gamma, "),
    ("~loss.gama", "loss.gama: unknown key; did you mean gamma? allowed: gamma, "),
    ("optimizer.lerning_rate=1", "optimizer.lerning_rate: unknown key; did you mean learning_"),
    ("colector.num_envs=4", "colector: unknown key; did you mean collector? allowed: scenario"),
    ("+colector=multi", "colector: unknown key; did you mean collector? allowed: scenario"),
    ("collector/multi=4", "collector.multi: unknown key; allowed: num_envs, "),
    ("network.depth=3", "network.depth: unknown key; allowed: mu, "),
    ("+ray.adress=3", "ray.adress: unknown key; did you mean address? allowed: address"),
    ("hydra.run.dir=x", "hydra: unknown key; allowed: scenario, "),
    ("+hydra.x=x", "hydra: unknown key; allowed: scenario, "),
    ("hydra/launcher=basic", "hydra: unknown key; allowed: scenario, "),
    ("defaults=[]", "defaults: unknown key; allowed: scenario, "),
    ("+training_overrides.rod.length=1", "training_overrides.rod: unknown key; did you mean road?"),
    ("+training_overrides.road.lanes=3", "training_overrides.road.lanes: unknown key; did you me"),
    ("+training_overrides={road:{lanes:3}}", "training_overrides.road.lanes: unknown key; did "),
    ("training_overrides={sed:3}", "training_overrides.sed: unknown key; allowed: name, "),
]
FORM = [
    ("seed", "'seed': must be FIELD=VALUE in the syntax of hydra: "),
    ("seed=[1", "'seed=[1': must be FIELD=VALUE in the syntax of hydra: "),
    ("=3", "'=3': must be FIELD=VALUE, with the name of a field"),
    ("@loss=3", "'@loss=3': must be FIELD=VALUE, with the name of a field"),
    ("recipe@loss=paper", "'recipe@loss=paper': must be FIELD=VALUE, with the name of a field"),
    ("seed=1,2", "'seed=1,2': must have one value; "),
    ("seed=range(1,3)", "'seed=range(1,3)': must have one value; "),
    ("seed=" + "[" * 400, "'seed=[[["),
    ("seed=" + "1" * 5000, "'seed=111"),
]
CHOICES = [
    ("recipe=wild", "recipe = 'wild': must be fast, interactive, long, paper"),
    ("recipe=null", "recipe = None: must be fast, interactive, long, paper"),
    ("recipe=[fast]", "recipe = ['fast']: must be fast, interactive, long, paper"),
    ("recipe=../config", "recipe = '../config': must be fast, interactive, long, paper"),
    ("~recipe", "recipe = None: must be fast, interactive, long, paper"),
    ("collector=cloud", "collector = 'cloud': must be multi, ray, single"),
]
NEEDED = [(f"~{name}", f"~{name}: {name} must be given") for name in ("seed", "loss.gamma", "loss")]


@pytest.mark.parametrize(("text", "message"), [*UNKNOWN, *FORM, *CHOICES, *NEEDED])
def test_what_is_refused(text, message):
    with pytest.raises(ConfigError) as caught:
        check_overrides(TrainingConfig, FOLDER, ["replay.batch_size=8", text])
    assert str(caught.value).startswith(message)
    assert len(str(caught.value).splitlines()) == 1
    assert len(str(caught.value)) < 400


@pytest.mark.parametrize(
    ("texts", "name"),
    [
        (["seed=1", "seed=1"], "seed"),
        (["recipe=fast", "recipe=paper"], "recipe"),
        (["seed=1", "++seed=2"], "seed"),
        (
            ["+training_overrides.road.length=1.0", "+training_overrides={road:{length:2.0}}"],
            "road",
        ),
        (["~training_overrides.warmup", "training_overrides.warmup=[1.0,2.0]"], "warmup"),
    ],
)
def test_nothing_is_given_twice(texts, name):
    with pytest.raises(ConfigError, match=rf"^'.*': .*{name}.* is given twice, before by '"):
        check_overrides(TrainingConfig, FOLDER, texts)


@pytest.mark.parametrize(
    "other", ["seed=3", "initial_checkpoint=a.pt", "num_workers=2", "recipe=fast", "~output"]
)
def test_beside_a_run_to_resume_nothing_is_ignored(other):
    texts = ["resume=runs/a", "ray.address=auto", other]
    message = rf"^resume = 'runs/a': must be alone, .*; beside it is '{other}'$"
    with pytest.raises(ConfigError, match=message):
        check_overrides(TrainingConfig, FOLDER, texts)
    check_overrides(TrainingConfig, FOLDER, texts[:2])
    if other != "~output":
        check_overrides(TrainingConfig, FOLDER, ["resume=null", other])


def test_what_is_allowed_is_told_by_its_keys():
    texts = [
        "seed=1",
        "++loss.gamma=0.5",
        "collector=multi",
        "collector.num_envs=4",
        "+training_overrides.road.num_lanes=5",
        "~training_overrides.warmup",
        "+training_overrides.followers.mix={adversarial:1.0}",
        "scenario='a,b.yaml'",
    ]
    assert check_overrides(TrainingConfig, FOLDER, texts) == [
        "seed",
        "loss.gamma",
        "collector",
        "collector.num_envs",
        "training_overrides.road.num_lanes",
        "training_overrides.warmup",
        "training_overrides.followers.mix.adversarial",
        "scenario",
    ]
