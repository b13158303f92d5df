"""``marl-lanes train``: the training of NAF where the repository is not at hand."""

import shlex
import sys
from pathlib import Path

import pytest
import yaml
from configs import resolve
from naf_program import TINY, UNRECORDED, prepare
from programs import replaced

from marl_lanes import load_scenario
from marl_lanes.cli.main import main
from marl_lanes.extras import MissingExtraError
from marl_lanes.recipes import naf

pytestmark = pytest.mark.training


def printed(capsys, *arguments):
    """What it prints before it ends the process."""
    with pytest.raises(SystemExit) as caught:
        main(["train", *arguments])
    assert caught.value.code == 0
    return capsys.readouterr().out


def test_the_help_has_the_fields_within_80_columns_and_examples_that_can_be(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    out = printed(capsys, "--help")
    assert out.startswith("usage: marl-lanes train [FIELD=VALUE ...] [--import MODULE]")
    assert "  loss.gamma: discount factor" in out
    assert max(map(len, out.splitlines())) <= 80
    examples = naf.DESCRIPTION.partition("examples:\n")[2].replace("\\\n", " ").splitlines()
    assert len(examples) > 3
    for example in examples:
        program, *overrides = shlex.split(example)
        assert program == "%(prog)s"
        resolve(*overrides)


def test_it_takes_what_the_program_takes(capsys):
    out = printed(capsys, "seed=7", "--cfg", "job", "recipe=paper")
    assert yaml.safe_load(out) == resolve("seed=7", "recipe=paper")


@pytest.mark.parametrize("arguments", [["--mu=damped"], ["gama=0.9"], ["seed=-1"], ["--import=x"]])
def test_bad_input_is_one_line_and_the_status_2(capsys, tmp_path, monkeypatch, arguments):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as caught:
        main(["train", *arguments])
    assert caught.value.code == 2
    out, err = capsys.readouterr()
    assert (out, err.count("\n"), err[:7]) == ("", 1, "error: ")
    assert list(tmp_path.iterdir()) == []


def test_without_the_extra_it_says_what_to_install(capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "hydra", None)
    assert main(["train"]) == 2
    assert "pip install 'marl-lanes[train]'" in capsys.readouterr().err
    assert issubclass(MissingExtraError, ValueError)


def test_it_begins_against_a_follower_of_the_user(tmp_path, monkeypatch):
    monkeypatch.chdir(prepare(tmp_path))
    # tests/agents/test_naf_train.py trains to the end.
    monkeypatch.setattr(naf, "run", lambda learner, *_: learner.close())
    Path("mine.py").write_text(
        "import numpy as np\n"
        "from marl_lanes import register_follower\n"
        "register_follower('brakes', lambda seen: np.full(len(seen), -1.0))\n",
        encoding="utf-8",
    )
    busy = Path("busy.yaml").read_text(encoding="utf-8")
    Path("busy.yaml").write_text(busy + "followers: {mix: {brakes: 1.0}}\n", encoding="utf-8")
    options = replaced([*TINY, UNRECORDED, "output=run"])
    assert main(["train", "--import", "mine", *options]) == 0
    command = Path("run/command.txt").read_text(encoding="utf-8")
    assert shlex.split(command) == ["marl-lanes", "train", "--import", "mine", *options]
    assert load_scenario("run/scenario.yaml").followers.mix == {"brakes": 1.0}
