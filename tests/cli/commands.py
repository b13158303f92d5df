"""Commands that several tests give, and what a refused one leaves."""

from marl_lanes.cli.main import main

EVALUATE = ["evaluate", "--policy", "damped-prior", "--maneuvers", "4"]
QUICK = "{num_agents: 4, departures: {interval: [2.0, 4.0]}, max_vehicles: 128}"
CROSSPLAY = ["crossplay", "--maneuvers", "8", "--changers"]
FOLLOWERS = ["followers", "--maneuvers", "12", "--seed", "1"]


def files(folder):
    return {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}


def assert_refused(capsys, folder, arguments, message):
    """One line on stderr, which contains the message, and nothing written."""
    before = files(folder)
    assert main(arguments) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("error: ")
    assert message in captured.err
    assert len(captured.err.splitlines()) == 1
    assert files(folder) == before
