"""Many trainings by one command: skipped, resumed, refused, several at once, interrupted."""

import importlib.util
import shlex
import shutil
import signal
import subprocess
import sys
import threading
import time

import pytest

from marl_lanes import studies
from marl_lanes.studies import Run, carry_out, is_finished
from marl_lanes.training.config import ConfigError
from marl_lanes.training.failures import TrainingError

PROGRAM = "programs/train.py"
# Trains for as many moments as it is told, and forgets none of them when it is interrupted.
SOURCE = """
import shlex, signal, sys, time
from pathlib import Path
stopped = []
def stop(*_):
    if stopped:
        sys.exit(3)
    stopped.append(1)
    (folder / "told").touch()
signal.signal(getattr(signal, "SIGBREAK", signal.SIGTERM), stop)
word, *options = sys.argv[1:]
fields = dict(option.split("=") for option in options)
print("algorithm", word)
is_new = "output" in fields
folder = Path(fields["output" if is_new else "resume"])
if is_new:
    folder.mkdir()
    (folder / "command.txt").write_text(shlex.join(["python", "programs/train.py", *sys.argv[1:]]))
    (folder / "moments").write_text(fields["moments"])
    done = 0
else:
    assert len(fields) == 1
    done = int((folder / "resume.pt").read_text())
(folder / "resume.pt").write_text(str(done))
total = int((folder / "moments").read_text())
while done < total and not stopped:
    done += 1
    time.sleep(0.01)
(folder / "resume.pt").write_text(str(done))
with (folder / "log").open("a") as log:
    log.write(f"to {done}\\n")
if total == 13:
    sys.exit("error: it diverges")
if done == total:
    (folder / "evaluation.json").write_text("{}")
"""


@pytest.fixture
def study(tmp_path, monkeypatch):
    """The folder of a study in a repository with one program."""
    program = tmp_path / PROGRAM
    program.parent.mkdir()
    program.write_text(SOURCE, encoding="utf-8")
    monkeypatch.setattr(sys, "argv", [str(program.with_name("study.py"))])
    return tmp_path / "study"


def make(name, moments=1):
    return Run(name, PROGRAM, ("td3", f"moments={moments}"))


def log(path):
    return (path / "log").read_text(encoding="utf-8").split("\n")[:-1]


def test_every_run_has_a_folder_and_a_log(study):
    assert carry_out([make("a"), make("b", 2)], study)
    assert [log(study / name) for name in "ab"] == [["to 1"], ["to 2"]]
    assert (study / "a.log").read_text(encoding="utf-8") == "algorithm td3\n"
    command = shlex.split((study / "a" / "command.txt").read_text(encoding="utf-8"))
    assert command == ["python", PROGRAM, "td3", "moments=1", f"output={study / 'a'}"]


def test_what_is_finished_is_skipped_and_what_is_begun_is_resumed(study):
    runs = [make("a"), make("b", 6)]
    assert carry_out(runs, study)
    (study / "b" / "resume.pt").write_text("4", encoding="utf-8")
    (study / "b" / "evaluation.json").unlink()
    assert carry_out(runs, study)
    assert [log(study / name) for name in "ab"] == [["to 1"], ["to 6", "to 6"]]
    assert (study / "b.log").read_text(encoding="utf-8") == "algorithm td3\n" * 2


def test_what_was_killed_before_its_first_state_begins_anew(study):
    assert carry_out([make("a")], study)
    for name in ("resume.pt", "evaluation.json"):
        (study / "a" / name).unlink()
    assert carry_out([make("a")], study)
    assert log(study / "a") == ["to 1"]


def test_a_folder_of_something_else_is_left_to_the_program(study):
    (study / "a").mkdir(parents=True)
    (study / "a" / "diary.txt").write_text("mine", encoding="utf-8")
    with pytest.raises(TrainingError, match=r"run a ended with status 1: FileExistsError.*a\.log"):
        carry_out([make("a")], study)
    assert (study / "a" / "diary.txt").exists()


def test_a_folder_may_have_moved(study):
    assert carry_out([make("a")], study)
    shutil.move(study, study.with_name("moved"))
    assert carry_out([make("a")], study.with_name("moved"))


def test_another_command_is_refused_before_anything_begins(study):
    assert carry_out([make("b")], study)
    with pytest.raises(ConfigError) as error:
        carry_out([make("a"), make("b", 2)], study)
    wanted = "must have been begun by 'python programs/train.py td3 moments=2', and was by "
    assert f"run {study / 'b'}: {wanted}" in str(error.value)
    assert not (study / "a").exists()


@pytest.mark.parametrize(
    ("runs", "number", "message"),
    [
        ([make("a"), make("a")], 1, "run 'a': must be the name of one folder, of one run"),
        ([make("../a")], 1, "run '../a': must be the name"),
        ([make("a")], 0, "processes = 0: must be at least 1"),
        ([Run("a", "programs/none.py", ())], 1, "program 'programs/none.py': must be a file"),
    ],
)
def test_what_cannot_be_carried_out(study, runs, number, message):
    with pytest.raises(ConfigError, match=message):
        carry_out(runs, study, num_processes=number)
    assert not study.exists()


def test_a_failure_is_told_when_the_others_are_finished(study):
    with pytest.raises(TrainingError) as error:
        carry_out([make("a", 13), make("b")], study)
    wanted = f"run a ended with status 1: error: it diverges (all in {study / 'a.log'})"
    assert str(error.value) == wanted
    assert is_finished(study / "b")


def interrupt_when(*are_times):
    """Interrupt this process once something is so, and again at the next, from another thread."""

    def wait():
        for is_time in are_times:
            while not is_time():
                time.sleep(0.01)
            signal.raise_signal(signal.SIGINT)

    threading.Thread(target=wait, daemon=True).start()


def test_an_interruption_is_passed_on_and_the_study_goes_on_from_there(study):
    runs = [make("a", 500), make("b", 500), make("c")]
    interrupt_when(lambda: all((study / name / "resume.pt").exists() for name in "ab"))
    assert not carry_out(runs, study, num_processes=2)
    before = [log(study / name) for name in "ab"]
    assert all(len(lines) == 1 and lines != ["to 500"] for lines in before)
    assert not (study / "c").exists()
    for name in "ab":
        (study / name / "moments").write_text("1", encoding="utf-8")
        (study / name / "resume.pt").write_text("1", encoding="utf-8")
    assert carry_out(runs, study, num_processes=2)
    assert [log(study / name) for name in "ab"] == [[*lines, "to 1"] for lines in before]


def test_a_second_interruption_stops_at_once(study):
    source = SOURCE.replace("and not stopped", "")
    (study.parent / PROGRAM).write_text(source, encoding="utf-8")
    run = study / "a"
    interrupt_when((run / "resume.pt").exists, (run / "told").exists)
    assert not carry_out([make("a", 3_000)], study)
    # Stopped in its midst: what it would write at its end is not there.
    assert not (run / "log").exists()


def test_on_windows_a_training_is_asked_to_end_and_is_not_killed(monkeypatch):
    monkeypatch.setattr(sys, "platform", "win32")
    monkeypatch.setattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 512, raising=False)
    monkeypatch.setattr(signal, "CTRL_BREAK_EVENT", 1, raising=False)
    spec = importlib.util.spec_from_file_location("there", studies.__file__)
    there = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(there)
    sent, ended = [], []

    class Process:
        send_signal = sent.append

    class Lonely:
        """There is no console."""

        def send_signal(self, _):
            raise OSError

        def terminate(self):
            ended.append(self)

    lonely = Lonely()
    there._interrupt({"one": Process(), "other": lonely})
    assert there._APART == {"creationflags": 512}
    assert (sent, ended) == ([1], [lonely])
