"""The programs of docs/examples, in a quick form, where what they need is installed."""

import importlib.util
import os
import re
import runpy
import sys
from pathlib import Path

import pytest
import torch

EXAMPLES = Path(__file__).parents[1] / "docs" / "examples"
NEEDS = {
    "agilerl_ippo": ("agilerl", ["--steps", "512"]),
    "benchmarl_tasks": ("benchmarl", ["--iterations", "1", "--algorithms", "ippo"]),
    "plain_torchrl": ("torchrl", ["--iterations", "1"]),
    "rllib_ppo": ("tree", ["--iterations", "1"]),
    "single_file": ("torch", ["--iterations", "1"]),
    "stable_baselines": ("stable_baselines3", ["--timesteps", "4096"]),
    "tianshou_ppo": ("tianshou", ["--steps", "512"]),
}
MEASURED = r"(return -\d+\.\d\d, completed \d\.\d\d) of 4 commands"


def test_every_example_is_here():
    names = {path.stem for path in EXAMPLES.glob("*.py")} - {"measuring"}
    assert names == set(NEEDS)


def test_every_example_that_needs_another_library_has_an_environment():
    names = {path.stem for path in (EXAMPLES / "environments").glob("*.txt")} - {"package"}
    assert names == set(NEEDS) - {"plain_torchrl", "single_file"}


def told_as(point):
    """A point of the file as the line of text has it."""
    return f"return {float(point[1]):.2f}, completed {float(point[2]):.2f}"


# AgileRL raises the first when it is imported; Tianshou takes an unbounded actor for a bounded one.
# BenchMARL has an old collector of TorchRL, and expects an end of a road's episode in each batch.
@pytest.mark.filterwarnings("ignore:MakeEvolvable will be deprecated:DeprecationWarning")
@pytest.mark.filterwarnings("ignore:action_scaling and action_bound_method are:UserWarning")
@pytest.mark.filterwarnings("ignore:SyncDataCollector has been deprecated:DeprecationWarning")
@pytest.mark.filterwarnings("ignore:No episode terminated this iteration:UserWarning")
@pytest.mark.training
@pytest.mark.parametrize("name", NEEDS)
def test_an_example_trains_and_measures(name, tmp_path, monkeypatch, capsys):
    package, options = NEEDS[name]
    # In the environment of an example it alone runs, and must not be left out.
    wanted = os.environ.get("EXAMPLE")
    if wanted not in {None, name}:
        pytest.skip(f"this environment is that of {wanted}")
    if wanted is None and importlib.util.find_spec(package) is None:
        pytest.skip(f"{package} is not installed")
    curve = tmp_path / "curve.csv"
    common = ["--episodes", "1", "--curve", str(curve)]
    monkeypatch.setattr(sys, "argv", [f"{name}.py", *common, *options])
    monkeypatch.syspath_prepend(str(EXAMPLES))
    torch.set_num_threads(1)
    runpy.run_path(str(EXAMPLES / f"{name}.py"), run_name="__main__")
    told = capsys.readouterr().out
    measured = re.findall(rf"(before|after|[\d,]+ steps): {MEASURED}", told)
    assert [when for when, _ in measured][:: len(measured) - 1] == ["before", "after"]
    head, *rows = curve.read_text(encoding="utf-8").splitlines()
    assert head == "num_steps,return,completed"
    points = [row.split(",") for row in rows]
    assert [numbers for _, numbers in measured] == [told_as(point) for point in points]
    steps = [int(point[0]) for point in points]
    assert steps[0] == 0 < steps[-1]
    assert steps == sorted(steps)
