"""The entry point: the help, errors that are one line, and what is imported."""

import io
import os
import re
import shlex
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import pytest
from checkpoints import save_trained
from cli.commands import QUICK
from report.runs import make_run

import marl_lanes
from marl_lanes import scenario
from marl_lanes.cli.arguments import EXAMPLES
from marl_lanes.cli.main import main, make_parser
from marl_lanes.extras import MissingExtraError


@pytest.mark.parametrize("command", ["evaluate", "crossplay", "followers"])
def test_help_ends_with_0(capsys, command):
    with pytest.raises(SystemExit) as caught:
        main([command, "--help"])
    assert caught.value.code == 0
    shown = capsys.readouterr().out
    assert "--maneuvers" in shown
    assert "--import MODULE" in shown


LIGHT = [[], ["scenarios"], ["validate", "paper"], ["evaluate", "--policy", "x"], ["--help"]]


def test_commands_that_do_not_drive_import_nothing_heavy():
    text = (
        "import sys\n"
        "from contextlib import suppress\n"
        "from marl_lanes.cli.main import main\n"
        f"for arguments in {LIGHT}:\n"
        "    with suppress(SystemExit):\n"
        "        main(arguments)\n"
        "    heavy = {'argcomplete', 'numba', 'torch', 'pettingzoo', 'matplotlib'}\n"
        "    print('heavy:', *sorted(heavy & set(sys.modules)))\n"
    )
    command = [sys.executable, "-W", "error", "-c", text]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    told = [line for line in done.stdout.splitlines() if line.startswith("heavy:")]
    assert told == ["heavy:"] * len(LIGHT)


def parsers():
    """Of each command."""
    return next(one for one in make_parser()._actions if isinstance(one.choices, dict)).choices


def shown_by(capsys, *arguments):
    """What a command prints that ends the process."""
    with pytest.raises(SystemExit) as caught:
        main(arguments)
    assert caught.value.code == 0
    return capsys.readouterr().out


def test_alone_it_names_three_commands_that_there_are(capsys):
    assert main([]) == 0
    out = capsys.readouterr().out
    named = re.findall(r"^  marl-lanes (.*?)  ", out, re.MULTILINE)
    assert len(named) == 3
    for line in named:
        make_parser().parse_args(line.split())


def test_the_version_is_that_of_the_package(capsys):
    assert marl_lanes.__version__ == version("marl-lanes")
    assert shown_by(capsys, "--version") == f"marl-lanes {version('marl-lanes')}\n"


def test_the_help_lists_every_command_in_one_line_and_the_statuses(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    out = shown_by(capsys, "--help")
    rows = {row.split()[0] for row in out.splitlines() if re.match(r"    [a-z-]+ +[a-z]", row)}
    assert rows >= set(parsers()) - {"benchmark-table"}
    assert max(map(len, out.splitlines())) <= 80
    assert re.findall(r"^  (\d+) ", out, re.MULTILINE) == ["0", "1", "2", "130"]


@pytest.mark.parametrize("name", sorted(set(parsers()) - {"train"}))
def test_every_help_fits_in_80_columns_and_has_examples_that_the_parser_takes(
    capsys, monkeypatch, name
):
    monkeypatch.setenv("COLUMNS", "80")
    out = shown_by(capsys, name, "--help")
    assert max(map(len, out.splitlines())) <= 80
    examples = out.partition(EXAMPLES)[2].replace("\\\n", " ").splitlines()
    assert examples
    for example in examples:
        program, command, *arguments = shlex.split(example.partition(">")[0])
        assert (program, command) == ("marl-lanes", name)
        make_parser().parse_args([command, *arguments])


def raise_error(error):
    def load(_):
        raise error

    return load


@pytest.mark.parametrize(
    ("error", "status", "line"),
    [
        (KeyboardInterrupt(), 130, "interrupted"),
        (MemoryError(), 2, "error: there is not enough memory for this"),
        (ValueError("one\n  two\x1b[2J\udcff"), 2, r"error: one two\x1b[2J\udcff"),
        (OSError(28, "No space left on device"), 2, "error: [Errno 28] No space left on device"),
        (MissingExtraError("x: is not installed"), 2, "error: x: is not installed"),
        (ValueError("x" * 5000), 2, f"error: {'x' * 493} ... {'x' * 500}"),
    ],
)
def test_an_error_is_one_line(capsys, monkeypatch, error, status, line):
    monkeypatch.setattr(scenario, "load_scenario", raise_error(error))
    assert main(["show", "paper"]) == status
    captured = capsys.readouterr()
    assert (captured.out, captured.err) == ("", f"{line}\n")


def test_a_bug_is_no_bad_input(monkeypatch):
    monkeypatch.setattr(scenario, "load_scenario", raise_error(TypeError("a bug")))
    with pytest.raises(TypeError, match="a bug"):
        main(["show", "paper"])


def ascii_stream(_):
    return io.TextIOWrapper(io.BytesIO(), encoding="ascii")


def left_stream(_):
    reader, writer = os.pipe()
    os.close(reader)
    return os.fdopen(writer, "w", encoding="utf-8")


def full_stream(_):
    return Path("/dev/full").open("w", encoding="utf-8")


@pytest.fixture(scope="module")
def named(tmp_path_factory):
    """Files whose names the terminal's encoding lacks, and a finished run."""
    folder = tmp_path_factory.mktemp("named")
    save_trained(folder / "räum.pt")
    save_trained(folder / "\udcff.pt")
    (folder / "schnell_é.yaml").write_text(QUICK, encoding="utf-8")
    rows = ["--seconds", "1", "--out", str(folder / "straße.parquet")]
    assert main(["record", "lane-keeping", *rows]) == 0
    make_run(folder / "läufe")
    return folder


COMMANDS = [
    ("scenarios", ""),
    ("show schnell_é.yaml --json è.json", "è.json"),
    ("evaluate räum.pt --maneuvers 2 --json ü.json", "ü.json"),
    ("evaluate \udcff.pt --maneuvers 2 --json \udcfe.json", "\udcfe.json"),
    (
        "crossplay --changers räum.pt \udcff.pt --followers neutral --maneuvers 2 --figure ö.svg",
        "ö.svg",
    ),
    (
        "followers \udcff.pt --maneuvers 12 --scenario schnell_é.yaml --json ä.json --figure ä.svg",
        "ä.json ä.svg",
    ),
    ("record \udcff.pt --seconds 1 --out ß.csv --out \udcfd.png", "ß.csv \udcfd.png"),
    ("replay straße.parquet --out ø.html", "ø.html"),
    ("report läufe", "läufe/report.html"),
    ("doctor --json é.json", "é.json"),
]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "written", "make_stream"),
    [
        *((*command, ascii_stream) for command in COMMANDS),
        *((*command, left_stream) for command in (COMMANDS[0], COMMANDS[2], COMMANDS[-1])),
        *((*command, full_stream) for command in (COMMANDS[0], COMMANDS[2], COMMANDS[-1])),
    ],
)
def test_results_are_written_whatever_the_terminal_is(
    capsys, monkeypatch, named, arguments, written, make_stream
):
    monkeypatch.chdir(named)
    for name in written.split():
        (named / name).unlink(missing_ok=True)
    with make_stream(named) as stream:
        monkeypatch.setattr(sys, "stdout", stream)
        status = main(arguments.split())
    err = capsys.readouterr().err
    if make_stream is full_stream:
        assert (status, err) == (2, "error: standard output: No space left on device\n")
    else:
        assert (status, err) == (0, "")
    assert all((named / name).stat().st_size > 0 for name in written.split())
