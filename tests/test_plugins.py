"""Modules of the user: what they register, and policies that their functions make."""

import re
import sys

import numpy as np
import pytest

from marl_lanes import load_scenario
from marl_lanes.plugins import import_modules, import_policy, imported, names_function

PAPER = load_scenario("paper")
SEEN = np.ones((3, 6), np.float32)


@pytest.fixture
def write(tmp_path, monkeypatch):
    """Writes the module ``mine`` into the current folder."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delitem(sys.modules, "mine", raising=False)
    file = tmp_path / "mine.py"
    yield lambda text: file.write_text(text, encoding="utf-8")
    sys.modules.pop("mine", None)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("absent", "--import absent: No module named 'absent'"),
        ("../x", "--import '../x': must be the dotted name of a module"),
    ],
)
def test_another_module_is_refused(name, message):
    before = list(sys.path)
    imported.clear()
    with pytest.raises(ValueError) as caught:  # noqa: PT011
        import_modules(["json", name])
    assert str(caught.value) == message
    assert sys.path == before
    assert imported == ["json"]


def test_another_folder_may_be_searched(tmp_path, monkeypatch):
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / "there.py").write_text("found = 1\n", encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ValueError, match="No module named 'there'"):
        import_modules(["there"])
    import_modules(["there"], tmp_path / "elsewhere")
    assert sys.modules.pop("there").found == 1


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1 / 0\n", "ZeroDivisionError: division by zero (%s, line 1)"),
        ("\nraise SystemExit('no')\n", "SystemExit: no (%s, line 2)"),
        ("import missing\n", "No module named 'missing'"),
    ],
)
def test_what_a_module_raises_is_told(tmp_path, monkeypatch, text, message):
    monkeypatch.chdir(tmp_path)
    file = tmp_path / "raising.py"
    file.write_text(text, encoding="utf-8")
    wanted = f"--import raising: {message.replace('%s', str(file))}"
    with pytest.raises(ValueError, match=f"^{re.escape(wanted)}$"):
        import_modules(["raising"])


@pytest.mark.parametrize("name", ["mine:make", "a.b:c"])
def test_what_names_a_function(name):
    assert names_function(name)


@pytest.mark.parametrize("name", ["mine", "mine:", ":make", "a/b:c", "a:b:c", "final.pt:x y", ""])
def test_what_names_none(name):
    assert not names_function(name)


def test_a_function_is_given_the_scenario_and_makes_the_policy(write):
    write("def make(scenario):\n    return lambda seen: seen[:, :1] * scenario.num_agents\n")
    before = list(sys.path)
    actions = import_policy("mine:make", PAPER)(SEEN)
    assert actions.dtype == np.float64
    assert actions.tolist() == [[10.0]] * 3
    assert sys.path == before


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "AttributeError: module 'mine' has no attribute 'make'"),
        ("def make(scenario):\n    return 3\n", "must return a function, got 3"),
        ("def make(scenario):\n    raise KeyError('x')\n", "KeyError: 'x' ("),
        ("make = lambda _: lambda seen: seen[:, 0]\n", "the shape (3,), must have (3, 1)"),
        ("make = lambda _: lambda seen: 1 / 0\n", "ZeroDivisionError: division by zero ("),
        ("make = lambda _: lambda seen: 'left'\n", "ValueError: could not convert"),
    ],
)
def test_another_policy_is_refused_in_one_line(write, text, message):
    write(text)
    with pytest.raises(ValueError, match=f"^policy mine:make: .*{re.escape(message)}"):
        import_policy("mine:make", PAPER)(SEEN)


def test_a_module_that_is_not_there_is_named(write):
    write("")
    with pytest.raises(ValueError, match=r"^policy absent:make: No module named 'absent'$"):
        import_policy("absent:make", PAPER)
