"""The training program's help, and that a bad option or a full disk is one line."""

import pytest
from kills import fill_disk, run_until
from naf_program import PROGRAM, TINY, UNRECORDED, prepare, run_program
from programs import load_program

from marl_lanes.training.resume import read_state

pytestmark = pytest.mark.training


@pytest.fixture(scope="module")
def program():
    """The program as a module, in this process."""
    return load_program(PROGRAM)


def test_the_command_line_explains_itself(program, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for arguments in (["--help"], ["seed=3", "--cfg", "job", "scenario=interactive"]):
        with pytest.raises(SystemExit) as caught:
            program.main(arguments)
        assert caught.value.code in {0, None}
    out = capsys.readouterr().out
    usage, _, composed = out.partition("scenario: interactive\n")
    assert "python agents/naf/train.py" in usage
    assert "  optimizer.mu_learning_rate: step size of mu" in usage
    assert "seed: 3\n" in composed
    assert "recipe: interactive\n" in composed
    assert list(tmp_path.iterdir()) == []


def test_an_unknown_key_is_one_error_and_no_folder(tmp_path):
    option = "optimizer.lerning_rate=1"
    code, out, err = run_program(*TINY, option, "output=run", folder=prepare(tmp_path))
    assert code == 2
    assert err.startswith("error: optimizer.lerning_rate: unknown key; did you mean learning_rate?")
    assert out == ""
    assert len(err.splitlines()) == 1
    assert [path.name for path in tmp_path.iterdir()] == ["busy.yaml"]


def test_a_bad_value_is_one_error_and_no_folder(program, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(prepare(tmp_path))
    with pytest.raises(SystemExit) as caught:
        program.main([*TINY, "network.mu=foo", "output=run"])
    assert caught.value.code == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("error: network.mu = 'foo': ")
    assert len(err.splitlines()) == 1
    assert [path.name for path in tmp_path.iterdir()] == ["busy.yaml"]


@pytest.mark.parametrize("place", [2, 9, 13, 16, 30])
def test_a_full_disk_is_one_line_and_the_last_state_stays(program, tmp_path, place):
    run = prepare(tmp_path) / "run"
    options = [*TINY, UNRECORDED, "output=run"]
    status, printed = run_until(program, tmp_path, options, place, fill_disk(0))
    assert status in {1, 2}, printed[-3000:]
    (line,) = [line for line in printed.splitlines() if "error:" in line]
    assert "File too large" in line
    assert "Traceback" not in printed
    if place <= 13:
        assert not run.exists()
    else:
        read_state(run / "resume.pt")
        assert "resume=run" in line
