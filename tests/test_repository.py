"""The repository's layout and hygiene."""

import os
import re
import shutil
import subprocess
import tomllib
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import pytest
import yaml
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from packaging.version import Version

from marl_lanes.zoo.index import read_index

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
EXTRAS = PROJECT["optional-dependencies"]
FOLDERS = ["agents", "benchmarks", "docs", "marl_lanes", "scenarios", "tests"]
FILES = [".ci/run", "CHANGELOG.md", "LICENSE", "Makefile", "README.md", "SECURITY.md"]
FILES += ["CITATION.cff", "CODE_OF_CONDUCT.md", "CONTRIBUTING.md", "MANIFEST.in", "mkdocs.yml"]
FILES += [".github/pull_request_template.md", ".github/workflows/tests.yml"]
FILES += ["constraints.txt", "constraints-lowest.txt", "constraints-newest.txt", "pyproject.toml"]
MAX_LINES = 420

UNTESTED = {
    "training/algorithms/algorithm.py": "the interface of the algorithms, without code",
}
"""Modules without a test file of their name, and why."""

# Split, so that this file does not match.
FORBIDDEN = re.compile(
    "|".join(
        [
            r"(?<![\w.~-])/(?:work|home|tmp|root|Users)" + "/",
            r"\b(?:files\." + r"pythonhosted|pypi)" + r"\.org",
            r"\b(?:index|extra-index|find-links)" + r"[-_]url\b",
            r"download\.pytorch" + r"\.org",
        ]
    )
)


def tracked():
    """Every file that git tracks, or would track."""
    git = shutil.which("git")
    assert git is not None
    done = subprocess.run(
        [git, "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    )
    names = sorted(set(filter(None, done.stdout.split("\0"))))
    return [ROOT / name for name in names if (ROOT / name).is_file()]


def requirements():
    lists = [PROJECT["dependencies"], *(EXTRAS[name] for name in ("view", "train", "ray", "dev"))]
    parsed = {Requirement(text) for lines in lists for text in lines}
    return sorted((one for one in parsed if one.name != PROJECT["name"]), key=str)


def read_pins(name):
    """Versions of a file of constraints by canonical name."""
    lines = (ROOT / name).read_text(encoding="utf-8").splitlines()
    found = {}
    for line in (text.split("#")[0].strip() for text in lines):
        if line:
            constraint = Requirement(line)
            (specifier,) = constraint.specifier
            assert specifier.operator == "=="
            assert canonicalize_name(constraint.name) not in found, line
            found[canonicalize_name(constraint.name)] = Version(specifier.version)
    return found


def read(name):
    return (ROOT / name).read_text(encoding="utf-8")


PINS = {path.name: read_pins(path.name) for path in ROOT.glob("constraints*.txt")}


@pytest.mark.parametrize("name", FOLDERS)
def test_the_folders_are_there(name):
    folder = ROOT / name
    assert folder.is_dir()
    assert any(path.is_relative_to(folder) for path in tracked()), "git holds no file of it"


@pytest.mark.parametrize("name", FILES)
def test_the_files_are_there(name):
    assert (ROOT / name).is_file()
    assert (ROOT / name).read_text(encoding="utf-8").strip()


def test_the_ci_command_can_be_executed():
    assert os.access(ROOT / ".ci" / "run", os.X_OK)
    assert (ROOT / ".ci" / "run").read_text(encoding="utf-8").startswith("#!")


@pytest.mark.parametrize("requirement", requirements(), ids=lambda one: one.name)
def test_every_dependency_is_pinned_within_its_range(requirement):
    name = canonicalize_name(requirement.name)
    for file in ("constraints.txt", "constraints-newest.txt"):
        assert requirement.specifier.contains(PINS[file][name])
    # Every dependency needs a lower bound, and the tests are run with it.
    (lowest,) = (Version(one.version) for one in requirement.specifier if one.operator == ">=")
    assert PINS["constraints-lowest.txt"][name] == lowest


def test_what_makes_the_site_is_pinned_within_its_range():
    for requirement in map(Requirement, EXTRAS["docs"]):
        pin = PINS["constraints.txt"][canonicalize_name(requirement.name)]
        assert requirement.specifier.contains(pin)


def test_the_version_is_the_same_everywhere():
    newest = PROJECT["version"]
    cited = yaml.safe_load(read("CITATION.cff"))
    assert cited["version"] == newest
    versions = re.findall(r"^## \[(\d[^\]]*)\]", read("CHANGELOG.md"), re.MULTILINE)
    assert versions[0] == newest


def test_the_workflow_runs_what_ci_runs():
    jobs = yaml.safe_load(read(".github/workflows/tests.yml"))["jobs"]
    assert {"run": ".ci/run"} in jobs["whole"]["steps"]
    lowest = PROJECT["requires-python"].removeprefix(">=")
    assert min(jobs["quick"]["strategy"]["matrix"]["python"], key=Version) == lowest


@pytest.mark.parametrize("name", ["numba", "tensordict", "torch", "torchrl"])
def test_what_is_used_closely_has_an_upper_bound(name):
    """Names that these do not promise to keep are used: a new version is tested first."""
    (requirement,) = (one for one in map(Requirement, PROJECT["dependencies"]) if one.name == name)
    assert any(one.operator == "<" for one in requirement.specifier)


@pytest.mark.parametrize("requirement", requirements(), ids=lambda one: one.name)
def test_what_is_installed_is_within_its_range(requirement):
    try:
        installed = version(requirement.name)
    except PackageNotFoundError:
        assert str(requirement) not in PROJECT["dependencies"], "not installed"
        pytest.skip("not installed")
    assert requirement.specifier.contains(installed, prereleases=True), (
        f"{requirement.name} {installed}: outside of {requirement.specifier}, which was tested"
    )


def test_the_extras_are_as_documented():
    assert {"train", "dev"} <= set(EXTRAS)
    assert "marl-lanes[train]" in EXTRAS["dev"]
    assert PROJECT["license-files"] == ["LICENSE"]


def test_no_file_of_the_package_is_too_long():
    lengths = {
        path.relative_to(ROOT).as_posix(): len(path.read_text(encoding="utf-8").splitlines())
        for path in (ROOT / "marl_lanes").rglob("*.py")
    }
    assert len(lengths) > 20
    assert {name: count for name, count in lengths.items() if count > MAX_LINES} == {}


def test_every_module_has_the_test_file_of_its_name():
    package = ROOT / "marl_lanes"
    modules = {path.relative_to(package) for path in package.rglob("*.py")}
    modules = {path for path in modules if path.name != "__init__.py"}
    assert len(modules) > 70
    missing = {
        path.as_posix()
        for path in modules
        if not (ROOT / "tests" / path.with_name(f"test_{path.name}")).is_file()
    }
    assert missing == set(UNTESTED)


def test_every_folder_of_tests_is_a_folder_of_the_package():
    folders = {path.parent for path in (ROOT / "tests").rglob("*.py")} - {ROOT / "tests"}
    # The programs have tests, too; the reference of the step is for several of them.
    others = {"agents", "reference"}
    names = {path.relative_to(ROOT / "tests").as_posix() for path in folders} - others
    assert len(names) > 5
    assert {name for name in names if not (ROOT / "marl_lanes" / name).is_dir()} == set()


def test_no_file_names_a_machine_or_a_registry():
    found = []
    for path in tracked():
        try:
            text = path.read_text(encoding="utf-8")
        except UnicodeDecodeError:
            continue
        for number, line in enumerate(text.splitlines(), 1):
            if FORBIDDEN.search(line):
                found.append(f"{path.relative_to(ROOT)}:{number}: {line.strip()[:100]}")
    assert found == []


@pytest.mark.parametrize(
    ("line", "is_refused"),
    [
        ("see /wo" + "rk/shared/DESIGN.md", True),
        ("cd /ho" + "me/someone", True),
        ('open("/tm' + 'p/x")', True),
        ("--index" + "-url https://mirror", True),
        ("https://py" + "pi.org/simple", True),
        ("runs/paper, docs/work/that.md", False),
        ("https://pettingzoo.farama.org/home/", False),
        ("pip install marl-lanes", False),
    ],
)
def test_what_names_a_machine_or_a_registry(line, is_refused):
    assert (FORBIDDEN.search(line) is not None) == is_refused


def test_agents_is_not_a_package():
    inside = list((ROOT / "agents").rglob("*"))
    assert inside
    assert [path for path in inside if path.name == "__init__.py"] == []


def test_nothing_built_is_tracked():
    suffixes = {".nbc", ".nbi", ".pyc", ".whl", ".so", ".pt", ".ckpt"}
    found = {path.relative_to(ROOT).as_posix() for path in tracked() if path.suffix in suffixes}
    # The trained policies that ship: tests/zoo/ looks at each of them.
    shipped = {f"marl_lanes/zoo/{name}.pt" for name in read_index()}
    assert found == shipped
    assert [path for path in tracked() if path.stat().st_size > 1_000_000] == []
