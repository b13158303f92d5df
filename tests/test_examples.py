"""The programs of docs/examples, in a quick form, where what they need is installed."""

import importlib.util
import re
import runpy
import sys
from pathlib import Path

import pytest
import torch

EXAMPLES = Path(__file__).parents[1] / "docs" / "examples"
NEEDS = {
    "benchmarl_tasks": ("benchmarl", ["--iterations", "1", "--algorithms", "ippo"]),
    "plain_torchrl": ("torchrl", ["--iterations", "1"]),
    "rllib_ppo": ("tree", ["--iterations", "1"]),
    "single_file": ("torch", ["--iterations", "1"]),
    "stable_baselines": ("supersuit", ["--timesteps", "4096"]),
}
MEASURED = r"return -\d+\.\d\d, completed \d\.\d\d of \d+ commands"


def test_every_example_is_here():
    names = {path.stem for path in EXAMPLES.glob("*.py")} - {"measuring"}
    assert names == set(NEEDS)


@pytest.mark.training
@pytest.mark.parametrize("name", NEEDS)
def test_an_example_trains_and_measures(name, monkeypatch, capsys):
    package, options = NEEDS[name]
    if importlib.util.find_spec(package) is None:
        pytest.skip(f"{package} is not installed")
    monkeypatch.setattr(sys, "argv", [f"{name}.py", "--episodes", "1", *options])
    monkeypatch.syspath_prepend(str(EXAMPLES))
    torch.set_num_threads(1)
    runpy.run_path(str(EXAMPLES / f"{name}.py"), run_name="__main__")
    told = capsys.readouterr().out
    assert re.search(f"before: {MEASURED}", told)
    assert re.search(f"after: {MEASURED}", told)
