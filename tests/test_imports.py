"""The modules that `import marl_lanes` imports, and the names that it offers."""

import json
import subprocess
import sys

import pytest

import marl_lanes

HEAVY = ["numba", "pettingzoo", "tensordict", "torch", "torchrl"]
OF_SCENARIOS = ["numpy", "pydantic", "yaml"]


def loaded(statement, packages=HEAVY):
    """Those of the packages that a fresh interpreter has imported after the statement."""
    report = f"import json, sys\n{statement}\nprint(json.dumps(sorted(sys.modules)))"
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", report], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    modules = set(json.loads(done.stdout))
    return [name for name in packages if name in modules]


def test_importing_the_package_is_light():
    assert loaded("import marl_lanes; dir(marl_lanes)") == []


def test_scenarios_need_no_simulation():
    assert loaded("from marl_lanes import load_scenario; load_scenario('paper')") == []


def test_the_help_of_the_command_line_needs_neither_scenarios_nor_numpy():
    statement = "from marl_lanes.cli.main import make_parser; make_parser().format_help()"
    assert loaded(statement, [*HEAVY, *OF_SCENARIOS]) == []
    assert loaded("from marl_lanes import load_scenario", OF_SCENARIOS) == OF_SCENARIOS


@pytest.mark.parametrize("name", ["parallel_env", "env"])
def test_the_pettingzoo_environment_needs_no_torch(name):
    assert loaded(f"from marl_lanes import {name}") == ["numba", "pettingzoo"]
    if name == "env":
        assert loaded("import marl_lanes.envs.parallel") == ["numba", "pettingzoo"]


@pytest.mark.parametrize("name", ["Simulator", "register_follower", "FOLLOWER_COLUMNS"])
def test_the_simulator_is_numpy_and_numba(name):
    assert loaded(f"from marl_lanes import {name}") == ["numba"]


@pytest.mark.slow
def test_naf_needs_no_traffic():
    names = "NAFLoss, NAFNetwork"
    assert loaded(f"from marl_lanes import {names}") == ["tensordict", "torch", "torchrl"]


@pytest.mark.parametrize("name", marl_lanes.__all__)
def test_every_public_name_resolves(name):
    value = getattr(marl_lanes, name)
    assert value is getattr(marl_lanes, name)
    assert name in dir(marl_lanes)
    if name.isupper():
        return
    assert value.__name__ == name
    assert value.__module__.startswith("marl_lanes.")


def test_the_public_names_are_sorted_and_unique():
    assert sorted(set(marl_lanes.__all__)) == marl_lanes.__all__


def test_an_unknown_attribute_is_refused():
    with pytest.raises(AttributeError, match="module 'marl_lanes' has no attribute 'nothing'"):
        _ = marl_lanes.nothing
    with pytest.raises(ImportError, match="cannot import name 'nothing'"):
        exec("from marl_lanes import nothing")  # noqa: S102
