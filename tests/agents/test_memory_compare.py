"""The comparison of NAF with memory, with a grid, with neither: trainings and table."""

import json
import re
from pathlib import Path

import pytest
from programs import load_program

from marl_lanes import load_scenario
from marl_lanes.recipes.naf import read, start_network

AGENTS = Path(__file__).parents[2] / "agents"
PROGRAM = AGENTS / "memory" / "compare.py"
HEADER = (
    "road,command,outcome,is_success,command_time,end_time,num_aborts,return,optimal_return,"
    "cost_ratio\n"
)
pytestmark = pytest.mark.training


@pytest.fixture(scope="module")
def program():
    """The program as a module, in this process."""
    return load_program(PROGRAM)


def finish(run, folder, rows="0,0,completed,1,1.0,9.0,0,-6.0,-4.0,1.5\n"):
    """What a finished training leaves, as far as the table reads it."""
    path = folder / run.name
    path.mkdir()
    (path / "evaluation.json").write_text('{"success_rate": 0.5, "mean_episode_reward": -20.0}')
    (path / "final_maneuvers.csv").write_text(HEADER + rows)


def test_every_training_is_one_that_the_program_of_naf_accepts(program, tmp_path):
    program.write_scenarios("hidden", tmp_path)
    sizes = {}
    for view in program.VIEWS:
        run = program.make_run(view, 3, 100_000, tmp_path)
        config = read([*run.arguments, f"output={tmp_path / run.name}"])
        assert (run.program, config.seed) == ("agents/naf/train.py", 3)
        assert config.optimizer.pretraining_transitions == 37_500
        network = start_network(config, load_scenario(config.scenario))
        assert load_scenario(config.scenario).name == "hidden"
        sizes[view] = len(network.features), len(network.encoder.outputs)
    assert sizes == {"plain": (15, 15), "stacked": (120, 120), "gru": (120, 47), "grid": (135, 31)}


def test_the_table_is_of_all_finished_trainings(program, tmp_path, capsys, monkeypatch):
    def carry_out(runs, folder, *, num_processes):
        assert num_processes == 2
        assert [run.name for run in runs] == ["plain_0", "gru_0", "plain_5", "gru_5"]
        finish(
            runs[0], folder, "0,0,missed,0,1.0,60.0,2,-6.0,,\n1,0,completed,1,0,9,1,-5,-4,1.25\n"
        )
        for run in runs[1:]:
            finish(run, folder)
        (folder / "stacked_0").mkdir()  # begun
        return False

    monkeypatch.setattr(program, "carry_out", carry_out)
    views = ["--views", "plain", "gru", "--seeds", "0", "5", "--processes", "2"]
    program.main([*views, "--output", str(tmp_path)])
    found = json.loads((tmp_path / "comparison.json").read_text("utf-8"))
    assert list(found) == ["plain", "gru"]
    assert found["plain"]["success"]["value"] == pytest.approx(2 / 3)
    assert found["plain"]["missed"]["value"] == pytest.approx(1 / 3)
    assert found["plain"]["aborts"]["value"] == pytest.approx(1.0)
    assert found["plain"]["time"]["value"] == pytest.approx(8.5)
    assert found["plain"]["cost_ratio"]["value"] == pytest.approx(11 / 8)
    assert found["plain"]["reward"] == {"value": -20.0, "low": -20.0, "high": -20.0}
    assert found["gru"]["seeds"] == {"0": 0.5, "5": 0.5}
    lines = capsys.readouterr().out.splitlines()
    assert [line.count("|") for line in lines[:4]] == [9] * 4
    assert lines[2].startswith("| plain | 66.7")
    assert lines[-1].startswith("interrupted")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--views", "lstm"], "invalid choice: 'lstm'"),
        (["--views", "gru", "gru"], "--views .*: must name each once"),
        (["--seeds", "1", "1"], "--seeds .*: must name each once"),
        (["--transitions", "0"], "--transitions 0: must be at least 1"),
        (["--processes", "0"], "--processes 0: must be at least 1"),
        (["--scenario", "nowhere"], "no such scenario"),
    ],
)
def test_what_cannot_be_is_one_clear_error(program, tmp_path, capsys, options, message):
    output = tmp_path / "study"
    with pytest.raises(SystemExit) as caught:
        program.main([*options, "--output", str(output)])
    assert caught.value.code == 2
    said = capsys.readouterr().err.strip().splitlines()[-1]
    assert re.search(rf"^error: .*{message}", said), said
    assert not output.exists()
