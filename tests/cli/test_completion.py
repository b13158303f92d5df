"""Completion: the lines for each shell, and what is answered when TAB is pressed."""

import io
import os

import argcomplete
import pytest
from cli.commands import assert_refused

from marl_lanes.cli import completion
from marl_lanes.cli.main import main, make_parser


@pytest.mark.parametrize("shell", completion.SHELLS)
def test_the_lines_for_a_shell_name_the_command(capsys, shell):
    assert main(["completion", shell]) == 0
    out = capsys.readouterr().out
    assert "_ARGCOMPLETE" in out
    assert "marl-lanes" in out
    assert ("fish" in out) == (shell == "fish")


@pytest.mark.parametrize("arguments", [[], ["tcsh"], [""], ["bash", "zsh"], ["bash", "--json"]])
def test_another_call_is_refused(capsys, tmp_path, arguments):
    assert_refused(capsys, tmp_path, ["completion", *arguments], "see marl-lanes")


def raise_error(*_):
    raise OSError


def answered(monkeypatch, line):
    """What is offered at the end of a line."""
    for name, value in (("", "1"), ("_IFS", "|"), ("_SUPPRESS_SPACE", "1"), ("_SHELL", "fish")):
        monkeypatch.setenv(f"_ARGCOMPLETE{name}", value)
    monkeypatch.setenv("COMP_LINE", line)
    monkeypatch.setenv("COMP_POINT", str(len(line)))
    out = io.StringIO()

    def autocomplete(parser, **options):
        finder = argcomplete.CompletionFinder()
        finder(parser, exit_method=lambda _: None, output_stream=out, **options)

    # It would open the descriptor 9, which is not the shell's here.
    monkeypatch.setattr(os, "fdopen", raise_error)
    monkeypatch.setattr(argcomplete, "autocomplete", autocomplete)
    completion.answer(make_parser())
    return set(filter(None, out.getvalue().split("|")))


@pytest.mark.parametrize(
    ("line", "offered"),
    [
        ("marl-lanes sc", {"scenarios", "schema"}),
        ("marl-lanes evaluate --sc", {"--scenario"}),
        ("marl-lanes evaluate --policy tu", {"tuned-cascade"}),
        ("marl-lanes evaluate --scenario inter", {"interactive"}),
        ("marl-lanes evaluate zoo:pa", {"zoo:paper"}),
        ("marl-lanes crossplay --changers tuned-cascade --followers adv", {"adversarial"}),
        ("marl-lanes show den", {"dense"}),
        ("marl-lanes replay ro", {"roads.parquet"}),
        ("marl-lanes completion f", {"fish"}),
        ("marl-lanes train loss.gam", {"loss.gamma="}),
        ("marl-lanes train seed=1 recipe=f", {"recipe=fast"}),
        ("marl-lanes train --c", {"--cfg"}),
    ],
)
def test_what_may_come_next_is_offered(monkeypatch, tmp_path, line, offered):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "roads.parquet").touch()
    assert answered(monkeypatch, line) == offered


def test_nothing_is_answered_that_no_shell_has_asked(monkeypatch):
    monkeypatch.delenv("_ARGCOMPLETE", raising=False)
    monkeypatch.setattr(argcomplete, "autocomplete", lambda *_, **__: pytest.fail("asked"))
    completion.answer(make_parser())
