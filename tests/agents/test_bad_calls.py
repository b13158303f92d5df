"""Bad calls of every program of agents/: one line that names the field, status 2, no file.

Each field of a program's configuration gets wrong values of every kind. `make test` tries those
that are refused before hydra composes, and a few of the others; `--long` tries all.
"""

import itertools
import shlex
from pathlib import Path
from types import UnionType
from typing import Annotated, Literal, NamedTuple, Union, get_args, get_origin

import pytest
from programs import BUSY, load_program
from pydantic import BaseModel

from marl_lanes.training.algorithms.naf import TrainingConfig

AGENTS = Path(__file__).parents[2] / "agents"


class Program(NamedTuple):
    path: Path
    first: list
    """Arguments of every call."""


PROGRAMS = {
    "naf": Program(AGENTS / "naf" / "train.py", ["output=run"]),
    "td3": Program(AGENTS / "baselines" / "train.py", ["td3", "output=run"]),
    "adversary": Program(AGENTS / "adversary" / "train.py", ["changer=none.pt", "output=run"]),
    "league": Program(AGENTS / "adversary" / "league.py", ["changer=none.pt", "output=run"]),
    "cascade": Program(AGENTS / "cascade" / "tune.py", ["--output", "run.json"]),
}
NUMBERS = ["nan", "-inf", "1e308", "-1e308", "1" + "0" * 40, "-1", "many", "true", "null", "[1]"]
WORDS = ["null", "[1]", "true", "{a: 1}"]
WRONG = {
    int: [*NUMBERS, "1.5", "'7'"],
    float: [*NUMBERS, "'0.5'", "inf"],
    bool: ["maybe", "3", "null", "[true]"],
    str: WORDS,
    list: [
        "3",
        "null",
        "[]",
        "[0]",
        "[-1]",
        "[1.5]",
        "[many]",
        "[1000000000000000000000]",
        "{a: 1}",
    ],
    dict: ["3", "null", "[1]", "text", "{a: 1}"],
    Literal: ["wrong", "null", "3", "[1]"],
}
FREE = {"resume", "changer", "scenario", "initial_checkpoint", "ray.address", "criterion"}
"""Names and paths, whose wrong values are below."""
RIGHT = {("held_out", "[]")}
"""Values that are wrong for other fields of the kind."""


def load(name, cache={}):  # noqa: B006
    if name not in cache:
        cache[name] = load_program(PROGRAMS[name].path)
    return cache[name]


def config_of(name):
    module = load(name)
    if name == "td3":
        return module.BASELINES["td3"].config
    if name == "naf":
        return TrainingConfig
    kinds = {"adversary": "AdversaryConfig", "league": "LeagueConfig"}
    return getattr(module, kinds[name])


def leaves(kind, prefix=""):
    """Dotted name and annotation of every field."""
    for name, field in kind.model_fields.items():
        inner = field.annotation
        if isinstance(inner, type) and issubclass(inner, BaseModel):
            yield from leaves(inner, f"{prefix}{name}.")
        else:
            yield prefix + name, inner


def wrong_values(annotation):
    """Texts that are no value of the field."""
    allows_null = get_origin(annotation) in (Union, UnionType)
    kind = get_args(annotation)[0] if allows_null else annotation
    if get_origin(kind) is Annotated:
        kind = get_args(kind)[0]
    values = WRONG[get_origin(kind) or kind]
    return [value for value in values if not (allows_null and value == "null")]


def of_fields(name):
    """Every field with every wrong value."""
    for field, annotation in leaves(config_of(name)):
        if field.rpartition(".")[2] not in FREE and field not in FREE:
            for value in wrong_values(annotation):
                if (field, value) not in RIGHT:
                    yield [f"{field}={value}"], field


def of_keys(name):
    """Every section with a key that it does not have, and every field without a value."""
    fields = [field for field, _ in leaves(config_of(name))]
    sections = {field.rpartition(".")[0] for field in fields}
    for section in sorted(sections):
        key = f"{section}.wrong_key".lstrip(".")
        for prefix in ("", "+", "++", "~"):
            yield [f"{prefix}{key}" + ("" if prefix == "~" else "=1")], "wrong_key"
    for field in fields:
        yield [f"~{field}"], field
        yield [f"{field}=1", f"{field}=2"], field


COMMON = """
-x ; -x
--config-dir=x ; --config-dir
--multirun seed=1 ; --multirun
--cfg ; --cfg
--cfg all ; all
seed ; seed
seed=1,2 ; seed=1,2
seed=${seed} ; seed
seed=${oc.env:NO_SUCH_VARIABLE} ; NO_SUCH_VARIABLE
seed=??? ; seed
+seed=1 ; seed
hydra.run.dir=x ; hydra
loss.gama=1 output.x=1 ; loss
training_overrides.road.num_lanes=4 ; training_overrides.road.num_lanes
+training_overrides.road.num_lanes=0 ; road.num_lanes = 0
+training_overrides.road.num_lanes=many ; road.num_lanes = 'many'
+training_overrides.time_step=nan ; time_step
+training_overrides.road=3 ; road
+training_overrides.num_lanes=3 ; num_lanes
training_overrides.num_slots=0 ; num_slots = 0
training_overrides.command.probability=0.0 ; command.probability = 0
training_overrides.command.probability=2.0 ; command.probability = 2.0
scenario=nowhere ; 'nowhere'
scenario=nowhere.yaml ; nowhere.yaml
scenario=null ; scenario
scenario='' ; scenario
scenario=3 ; '3'
scenario={a:1} ; scenario
scenario=endless.yaml ; num_agents
scenario=idle.yaml ; command.probability
resume=nowhere ; 'nowhere'
resume=busy.yaml ; 'busy.yaml'
resume='' ; ''
resume=3 ; '3'
resume=[1] ; resume
output='' ; output
output=busy.yaml ; 'busy.yaml'
output=busy.yaml/run ; busy.yaml
output=full ; 'full'
device=tpu ; 'tpu'
device=cuda:99 ; 'cuda:99'
device='' ; device
"""
OWN = {
    "naf": """
recipe=wild ; recipe = 'wild'
recipe=null ; recipe
recipe=[fast] ; recipe
recipe=fast recipe=paper ; recipe
recipe@loss=paper ; recipe@loss=paper
collector=cloud ; collector = 'cloud'
collector.kind=cloud ; 'cloud'
network.mu=wild ; network.mu = 'wild'
network.encoder=lstm ; network.encoder = 'lstm'
network.encoder=gru ; network.encoder = 'gru'
network.mu=cascade+idm ; network.mu = 'cascade+idm'
recipe=fast scenario=interactive ; network.mu = 'cascade'
recipe=interactive scenario=paper ; network.mu = 'cascade-gated+idm'
scenario=blind.yaml ; network.mu = 'cascade'
initial_checkpoint=nowhere.pt ; initial_checkpoint = 'nowhere.pt'
initial_checkpoint=busy.yaml ; initial_checkpoint = 'busy.yaml'
initial_checkpoint=. ; initial_checkpoint = '.'
initial_checkpoint=[1] ; initial_checkpoint
initial_checkpoint=zoo:nobody ; checkpoint zoo:nobody: no such policy in the zoo; allowed
num_workers=2 ; num_workers = 2
collector=multi num_workers=3 ; collector.num_envs = 256
ray.address=auto ; ray.address = 'auto'
ray.address=[1] ; ray.address
evaluation.criterion=beauty ; criterion = 'beauty'
exploration.final_sigma=0.5 ; final_sigma = 0.5
replay.warmup_transitions=1000000 ; replay.warmup_transitions = 1000000
collector.num_envs=1000000000 ; collector.num_envs = 1000000000
collector.steps_per_batch=1000000000 ; collector.steps_per_batch = 1000000000
replay.capacity=1000000000000 ; replay.capacity = 1000000000000
replay.batch_size=1000000000000 ; replay.batch_size = 1000000000000
evaluation.num_maneuvers=1000000000 ; evaluation.num_maneuvers = 1000000000
evaluation.final_num_maneuvers=1000000000 ; evaluation.final_num_maneuvers = 1000000000
network.hidden_sizes=[1000000,1000000] ; network.hidden_sizes = [1000000, 1000000]
""",
    "td3": """
algorithm=naf ; algorithm
collector.kind=cloud ; 'cloud'
num_workers=2 ; num_workers = 2
ray.address=auto ; ray.address = 'auto'
evaluation.criterion=beauty ; criterion = 'beauty'
collector.num_envs=1000000000 ; collector.num_envs = 1000000000
replay.capacity=1000000000000 ; replay.capacity = 1000000000000
network.hidden_sizes=[1000000,1000000] ; network.hidden_sizes = [1000000, 1000000]
recipe=paper ; recipe
""",
    "adversary": """
seed=1 ; changer = 'none.pt'
changer=busy.yaml ; 'busy.yaml'
objective=kind ; objective
follower.evaluation.criterion=beauty ; criterion = 'beauty'
follower.collector.num_envs=1000000000 ; follower.collector.num_envs = 1000000000
follower.replay.capacity=1000000000000 ; follower.replay.capacity = 1000000000000
follower.hidden_sizes=[1000000,1000000] ; follower.hidden_sizes = [1000000, 1000000]
hardening.replay.capacity=1 ; hardening
""",
    "league": """
seed=1 ; changer = 'none.pt'
changer=busy.yaml ; 'busy.yaml'
objective=adversarial ; objective
generations=0 ; generations = 0
exponent=-0.5 ; exponent = -0.5
followers=[nobody] ; 'nobody'
followers=[learned] ; 'learned'
held_out=[neutral] ; 'neutral'
held_out=[1st] ; held_out
hardening.evaluation.criterion=beauty ; criterion = 'beauty'
hardening.replay.capacity=1000000000000 ; hardening.replay.capacity = 1000000000000
follower.hidden_sizes=[1000000,1000000] ; follower.hidden_sizes = [1000000, 1000000]
""",
}
OPTIONS = ("generations", "population", "roads", "seconds", "seed")
CASCADE = [
    *(
        ([f"--{name}", value], name)
        for name in OPTIONS
        for value in ("-1", "many", "nan", "inf", "1e308", "1" + "0" * 40, "", "true", "[1]")
    ),
    *(([f"--{name}", "0"], name) for name in OPTIONS if name != "seed"),
    *(
        ([f"--{name}", value], name)
        for name in OPTIONS
        if name != "seconds"
        for value in ("1.5", "1e3", "0x10")
    ),
    *(([f"--{name}"], name) for name in (*OPTIONS, "scenario", "output")),
    (["--output", "."], "output"),
    (["--output", "busy.yaml/run.json"], "busy.yaml"),
    (["--output", "full"], "output"),
    (["--scenario", "nowhere"], "'nowhere'"),
    (["--scenario", "nowhere.yaml"], "nowhere.yaml"),
    (["--scenario", ""], "''"),
    (["--scenario", "full"], "'full'"),
    (["--scenario", "interactive"], "one action"),
    (["--scenario", "blind.yaml"], "features"),
    (["--population", "1000000", "--roads", "1000000"], "--population"),
    (["--gen", "3"], "--gen"),
    (["--wild"], "--wild"),
    (["seed=1"], "seed=1"),
    (["paper"], "paper"),
    (["-x"], "-x"),
    (["--generations=3=4"], "generations"),
]


def written(name):
    """The calls written above."""
    if name == "cascade":
        return CASCADE
    lines = (COMMON + OWN[name]).strip().splitlines()
    return [
        (shlex.split(call), part) for call, part in (line.split(" ; ") for line in lines if line)
    ]


def calls(name):
    """Arguments, and what the message must have."""
    if name == "cascade":
        return list(CASCADE)
    return [*of_keys(name), *written(name), *of_fields(name)]


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Where a program is called, with scenarios and a folder that holds something."""
    for name, text in (
        ("busy", BUSY),
        ("endless", "num_agents: null\n"),
        ("idle", "command: {probability: 0.0}\n"),
        ("blind", "observation: {features: [speed]}\n"),
    ):
        (tmp_path / f"{name}.yaml").write_text(text, encoding="utf-8")
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "notes.txt").touch()
    monkeypatch.chdir(tmp_path)
    return tmp_path


def check_call(name, arguments, part, folder, capsys):
    """It is refused in one line, and leaves nothing behind."""
    before = sorted(folder.rglob("*"))
    program = PROGRAMS[name]
    keys = {argument.partition("=")[0].lstrip("+~") for argument in arguments}
    first = [one for one in program.first if one.partition("=")[0] not in keys or "=" not in one]
    if any(argument.startswith("resume=") for argument in arguments):
        first = [one for one in first if "=" not in one]
    with pytest.raises(SystemExit) as caught:
        load(name).main([*first, *arguments])
    out, err = capsys.readouterr()
    said = f"{arguments}: {err}"
    assert caught.value.code == 2, said
    assert out == "", said
    assert err.startswith("error: "), said
    assert err.endswith("\n"), said
    assert len(err.splitlines()) == 1, said
    assert part in err, said
    assert len(err) < 1200, said
    assert sorted(folder.rglob("*")) == before, said


@pytest.mark.parametrize("name", PROGRAMS)
def test_calls_that_are_refused_at_once(name, folder, capsys):
    """Those that argparse or the check of the overrides refuses."""
    found = CASCADE if name == "cascade" else list(of_keys(name))
    assert len(found) > 60
    for arguments, part in found:
        check_call(name, arguments, part, folder, capsys)


@pytest.mark.parametrize("name", ["naf", "td3", "adversary", "league"])
def test_some_of_the_calls_that_are_composed_first(name, folder, capsys):
    found = [*written(name), *of_fields(name)]
    for arguments, part in itertools.islice(found, 5, None, len(found) // 5):
        check_call(name, arguments, part, folder, capsys)


@pytest.mark.long
@pytest.mark.parametrize("name", PROGRAMS)
def test_every_call(name, folder, capsys):
    found = calls(name)
    assert len(found) >= 80
    for arguments, part in found:
        check_call(name, arguments, part, folder, capsys)
