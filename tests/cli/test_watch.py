"""The command that shows a running simulation: as a process, with runs that change, to its end."""

import itertools
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from contextlib import contextmanager

import pytest
from browser.serving import TIMEOUT, listen
from checkpoints import save_trained, trained
from cli.commands import assert_refused

from marl_lanes import extras
from marl_lanes.cli.main import main
from marl_lanes.training.checkpoint import save_checkpoint

QUICK = """
name: quick
num_agents: 1
horizon: 8.0
warmup: [10.0, 10.0]
command: {probability: 1.0}
"""
"""An episode takes 13 s at most, so at a speed of 20 less than a second."""


class Watching:
    """The command, running."""

    def __init__(self, process):
        self.process = process
        line = process.stdout.readline()
        assert line.startswith("http://127.0.0.1:"), process.stderr.read()
        self.port = int(line.split()[0].rstrip("/").rpartition(":")[2])

    def end(self, number=signal.SIGINT):
        """Its exit status, its stderr, and how long its end took."""
        begun = time.monotonic()
        self.process.send_signal(number)
        _, err = self.process.communicate(timeout=TIMEOUT)
        return self.process.returncode, err, time.monotonic() - begun


@contextmanager
def watching(*arguments, **environment):
    command = [sys.executable, "-c", "from marl_lanes.cli.main import main; exit(main())", "watch"]
    with subprocess.Popen(
        [*command, *map(str, arguments)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "OMP_NUM_THREADS": "1", **environment},
    ) as process:
        try:
            yield Watching(process)
        finally:
            process.kill()


@pytest.fixture
def run(tmp_path):
    """The folder of a run that has not saved a model yet, with quick episodes."""
    folder = tmp_path / "run"
    (folder / "checkpoints").mkdir(parents=True)
    (folder / "scenario.yaml").write_text(QUICK, encoding="utf-8")
    return folder


@pytest.mark.slow
def test_the_page_is_opened_in_the_browser(tmp_path):
    browser = tmp_path / "browser"
    browser.write_text('#!/bin/sh\necho "$1" > "$0.asked"\n', encoding="utf-8")
    browser.chmod(0o755)
    asked = tmp_path / "browser.asked"
    with watching("tuned-cascade", "--open", BROWSER=f"{browser} %s") as running:
        end = time.monotonic() + TIMEOUT
        while not (asked.is_file() and asked.read_text(encoding="utf-8")):
            assert time.monotonic() < end
            time.sleep(0.05)
        assert asked.read_text(encoding="utf-8") == f"http://127.0.0.1:{running.port}/\n"
        assert running.end()[:2] == (0, "")


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_it_ends_at_once_also_with_open_streams(number):
    with watching("tuned-cascade", "--speed", 5) as running:
        with listen(running.port) as one, listen(running.port) as other:
            for events in (one, other):
                assert "rows" in [kind for kind, _ in itertools.islice(events, 4)]
            status, err, seconds = running.end(number)
        assert (status, err) == (0, "")
        # It takes less than a second; the limit leaves room for a busy computer.
        assert seconds < 3.0


@pytest.mark.slow
def test_the_newest_model_of_a_run_drives(run):
    """It waits for the first one, passes a broken one over, and survives the folder's end."""

    def save(transitions):
        path = run / "checkpoints" / f"step_{transitions:09d}.pt"
        save_checkpoint(path, trained(), "paper", transitions)

    def read_until(events, is_wanted):
        for kind, data in events:
            if is_wanted(kind, data):
                return data
        pytest.fail("the stream has ended")

    with watching(run, "--speed", 20, "--seed", 3) as running:
        with listen(running.port) as events:
            first = read_until(events, lambda kind, _: kind == "status")
            waiting = f"{run} has no saved model yet; the first one will drive"
            assert first == {"waiting": waiting, "trouble": None}
            save(1000)
            data = read_until(events, lambda kind, _: kind == "episode")
            assert data["header"]["policy"].endswith("step_000001000.pt, 1,000 transitions")
            assert data["header"]["scenario"] == "quick"
            assert data["header"]["seed"] == "3"
            broken = run / "checkpoints" / "step_000003000.pt"
            broken.write_bytes(b"half")
            told = read_until(events, lambda kind, data: kind == "status" and data["trouble"])
            assert str(broken) in told["trouble"]
            save(4000)
            data = read_until(
                events, lambda kind, data: kind == "episode" and "4,000" in data["header"]["policy"]
            )
            shutil.rmtree(run)
            told = read_until(events, lambda kind, data: kind == "status" and data["trouble"])
            assert told["trouble"] == f"{run}: the run folder is gone"
            data = read_until(events, lambda kind, _: kind == "episode")
            assert "4,000" in data["header"]["policy"]
        status, err, _ = running.end()
    assert status == 0
    lines = err.splitlines()
    assert len(lines) == 2
    assert lines[0].startswith(f"warning: passed over: checkpoint {broken}: ")
    assert lines[1] == f"warning: {run}: the run folder is gone"


@pytest.mark.slow
def test_a_port_in_use_is_refused(capsys, tmp_path):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        arguments = ["watch", "tuned-cascade", "--port", str(port)]
        assert_refused(capsys, tmp_path, arguments, f"--port {port}: address already in use")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["nowhere"], "nowhere: must be a run folder, a checkpoint, zoo:NAME"),
        (["."], "must be a run folder; it has no scenario.yaml"),
        (["broken.pt"], "broken.pt"),
        (["tuned-cascade", "--port", "70000"], "--port: '70000': must be a whole number, 0 to"),
        (["tuned-cascade", "--speed", "0"], "--speed: '0': must be a number, 0.1 to 20"),
        (["tuned-cascade", "--seed", "-1"], "--seed: '-1': must be a whole number, 0 to"),
        (["tuned-cascade", "--scenario", "nowhere"], "scenario 'nowhere': no such scenario"),
        (["tuned-cascade", "--import", "no_such_module"], "--import no_such_module"),
    ],
)
def test_what_cannot_be_is_refused(capsys, monkeypatch, tmp_path, arguments, message):
    (tmp_path / "broken.pt").write_bytes(b"broken")
    monkeypatch.chdir(tmp_path)
    assert_refused(capsys, tmp_path, ["watch", *arguments], message)


def test_a_checkpoint_must_fit_the_scenario(capsys, tmp_path):
    file = save_trained(tmp_path / "policy.pt")
    arguments = ["watch", str(file), "--scenario", "interactive"]
    assert_refused(capsys, tmp_path, arguments, "policy.pt")


@pytest.mark.parametrize("package", ["starlette", "uvicorn"])
def test_a_missing_package_is_named(capsys, monkeypatch, tmp_path, package):
    def refuse(name):
        if name == package:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

    monkeypatch.setattr(extras, "import_module", refuse)
    message = f"{package}: is not installed: pip install 'marl-lanes[view]'"
    assert_refused(capsys, tmp_path, ["watch", "tuned-cascade"], message)


def test_the_help_names_the_policies(capsys):
    with pytest.raises(SystemExit):
        main(["watch", "--help"])
    assert "tuned-cascade" in capsys.readouterr().out
