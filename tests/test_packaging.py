"""The wheel: its content, and that it runs without the rest of the repository."""

import shutil
import subprocess
import sys
import sysconfig
import venv
import zipfile
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).parents[1]
pytestmark = pytest.mark.slow

PROGRAM = """
import importlib.metadata
import sys
from pathlib import Path

import marl_lanes
from marl_lanes import list_scenarios, parallel_env

assert Path(marl_lanes.__file__).is_relative_to(sys.prefix), marl_lanes.__file__
modules = [module for name, module in sys.modules.items() if name.startswith("marl_lanes")]
env = parallel_env("paper", overrides={"warmup": [20.0, 20.0]})
observations, _ = env.reset(seed=0)
rewards = []
for _ in range(60):
    rewards += env.step({agent: [0.05] for agent in env.agents})[1].values()
assert all(Path(module.__file__).is_relative_to(sys.prefix) for module in modules), modules
assert min(rewards) < 0.0 == max(rewards)
from marl_lanes.zoo.index import find_file, read_index
for name in read_index():
    assert find_file(name).is_relative_to(sys.prefix), name
from marl_lanes.cli.main import main
from marl_lanes.scenario.json_schema import FILE
assert FILE.is_relative_to(sys.prefix)
assert main(["validate", *list_scenarios(), "--json", "valid.json"]) == 0
print(*list_scenarios())
print(importlib.metadata.version("marl-lanes"))
"""

TYPED = """
import numpy as np
from numpy.typing import NDArray

from marl_lanes import LaneChangeEnv, Scenario, load_scenario, parallel_env, register_follower


def brake(observations: NDArray[np.float32]) -> NDArray[np.float64]:
    return np.full(len(observations), -1.0)


register_follower("brake", brake)
scenario: Scenario = load_scenario("paper", {"followers": {"mix": {"brake": 1.0}}})
length: float = scenario.road.length
env = parallel_env(scenario, seed=0)
observations, infos = env.reset(seed=0)
steering: NDArray[np.float32] = observations["changer_0"]
roads = LaneChangeEnv(scenario, num_envs=2, seed=0)
number: int = roads.initial_seed
"""
"""How a program of somebody else uses the package."""


def run(*command, cwd, **environment):
    done = subprocess.run(
        [str(part) for part in command],
        cwd=cwd,
        env={"PATH": "", "PYTHONWARNINGS": "error", **environment},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """The wheel of a clean copy of this tree: what git tracks, or would track."""
    git = shutil.which("git")
    listing = run(git, "ls-files", "-z", "--cached", "--others", "--exclude-standard", cwd=ROOT)
    source = tmp_path_factory.mktemp("source")
    for name in filter(None, listing.split("\0")):
        if (ROOT / name).is_file():
            (source / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(ROOT / name, source / name)
    built = tmp_path_factory.mktemp("built")
    command = (sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", built)
    run(*command, cwd=source, PYTHONWARNINGS="default")
    (path,) = built.glob("*.whl")
    return path


@pytest.fixture(scope="module")
def names(wheel):
    with zipfile.ZipFile(wheel) as archive:
        return archive.namelist()


def test_marl_lanes_is_the_only_package_in_the_wheel(names):
    tops = {name.split("/")[0] for name in names}
    assert {name for name in tops if not name.endswith(".dist-info")} == {"marl_lanes"}
    assert len(tops) == 2


def test_the_wheel_holds_every_file_of_the_package_and_the_scenarios(names):
    inside = {
        path.relative_to(ROOT).as_posix()
        for path in (ROOT / "marl_lanes").rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    assert {"marl_lanes/py.typed", "marl_lanes/report/report.html.jinja"} < inside
    assert {"marl_lanes/zoo/zoo.json", "marl_lanes/zoo/paper.pt"} < inside
    assert {"marl_lanes/recipes/config.yaml", "marl_lanes/recipes/recipe/fast.yaml"} < inside
    scenarios = {f"marl_lanes/scenarios/{path.name}" for path in ROOT.glob("scenarios/*.yaml")}
    assert len(scenarios) >= 7
    expected = inside | scenarios | {"marl_lanes/scenarios/__init__.py"}
    assert {name for name in names if name.startswith("marl_lanes/")} == expected


def test_the_wheel_carries_its_license_and_command(wheel, names):
    assert any(name.endswith(".dist-info/licenses/LICENSE") for name in names)
    (entry_points,) = [name for name in names if name.endswith("entry_points.txt")]
    with zipfile.ZipFile(wheel) as archive:
        assert "marl-lanes = marl_lanes.cli.main:main" in archive.read(entry_points).decode()


@pytest.fixture(scope="module")
def installed(wheel, tmp_path_factory):
    """The interpreter of an environment with the wheel, and an empty folder to work in."""
    home, elsewhere = tmp_path_factory.mktemp("venv"), tmp_path_factory.mktemp("elsewhere")
    venv.create(home, with_pip=False, symlinks=True)
    python = home / "bin" / "python"
    install = ("install", "--quiet", "--no-deps", "--no-index", "--no-compile", wheel)
    pip = (sys.executable, "-m", "pip", "--disable-pip-version-check", "--python", python)
    run(*pip, *install, cwd=elsewhere, PYTHONWARNINGS="default")
    # The dependencies without .pth files, so that the editable install is not found.
    (site,) = home.glob("lib/python*/site-packages")
    paths = {sysconfig.get_path("purelib"), sysconfig.get_path("platlib")}
    (site / "dependencies.pth").write_text("\n".join(sorted(paths)) + "\n")
    return python, elsewhere


def test_the_installed_wheel_runs_from_another_folder(wheel, installed):
    python, elsewhere = installed
    # Interpreted, because compiling the kernel again would take half a minute.
    output = run(python, "-c", PROGRAM, cwd=elsewhere, NUMBA_DISABLE_JIT="1")
    *_, scenarios, version = output.splitlines()
    assert scenarios.split() == sorted(path.stem for path in ROOT.glob("scenarios/*.yaml"))
    assert wheel.name.startswith(f"marl_lanes-{version}-")
    # Up to where it would train: code, fields and recipes are in the wheel.
    train = (python.parent / "marl-lanes", "train", "scenario=interactive", "--cfg", "job")
    config = yaml.safe_load(run(*train, cwd=elsewhere, PYTHONWARNINGS="default"))
    assert (config["recipe"], config["network"]["mu"]) == ("interactive", "cascade-gated+idm")


@pytest.mark.parametrize("checker", ["mypy", "pyright"])
def test_its_types_are_seen_from_outside(installed, checker):
    python, elsewhere = installed
    (elsewhere / "right.py").write_text(TYPED, encoding="utf-8")
    (elsewhere / "wrong.py").write_text(TYPED.replace("length: float", "length: str"))
    option = {"mypy": ("--strict", "--python-executable"), "pyright": ("--pythonpath",)}[checker]
    command = [sys.executable, "-m", checker, *option, python]
    for name, status in (("right.py", 0), ("wrong.py", 1)):
        done = subprocess.run(
            [*command, name], cwd=elsewhere, capture_output=True, text=True, check=False
        )
        assert done.returncode == status, done.stdout + done.stderr
