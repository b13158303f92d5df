"""The comparison of algorithms: its plan, its intervals, its table, and what it refuses."""

import csv
import json
import multiprocessing.dummy
from pathlib import Path

import pytest
from programs import BUSY, load_program, run_main

from marl_lanes import load_scenario
from marl_lanes.files import write_json
from marl_lanes.training.checkpoint import make_actor_network, save_checkpoint

FOLDER = Path(__file__).parents[2] / "agents"
PROGRAM = FOLDER / "baselines" / "compare.py"
TOTAL = "collector.total_transitions"
BEGIN, END = "<!-- comparison -->", "<!-- end of comparison -->"


@pytest.fixture(scope="module")
def program():
    return load_program(PROGRAM)


def pretend(runs, folder, *, num_processes):
    """Instead of trainings: what they leave, untrained."""
    assert num_processes == 1
    for run in runs:
        path = folder / run.name
        if path.exists():
            continue
        (path / "checkpoints").mkdir(parents=True)
        given = dict(one.split("=") for one in run.arguments if "=" in one)
        count = int(given["collector.total_transitions"])
        scenario = load_scenario(given["scenario"])
        for name in ("step_000000007.pt", "final.pt"):
            network = make_actor_network(scenario, [4])
            save_checkpoint(path / "checkpoints" / name, network, scenario.name, count)
        write_json(path / "training.json", {"seconds_training": count / 8000})
        demonstrated = given.get("demonstrations.num_transitions", 0)
        text = f"demonstrations: {{num_transitions: {demonstrated}}}\n"
        (path / "config.yaml").write_text(text, "utf-8")
        (path / "metrics.csv").write_text(f"transitions,loss\n5,1.0\n{count + 9},0.5\n", "utf-8")
    return True


@pytest.mark.parametrize(
    "is_pretended", [True, pytest.param(False, marks=[pytest.mark.training, pytest.mark.long])]
)
def test_a_comparison_of_two_budgets_and_a_policy(program, tmp_path, monkeypatch, is_pretended):
    (tmp_path / "busy.yaml").write_text(BUSY, encoding="utf-8")
    docs = tmp_path / "docs.md"
    docs.write_text(f"before\n{BEGIN}\nold\n{END}\nafter\n", "utf-8")
    if is_pretended:
        monkeypatch.setattr(program, "carry_out", pretend)
    options = ["--quick", "--scenario", "busy.yaml", "--output", "out", "--seeds", "0"]
    options += ["--algorithms", "ippo", "--policies", "lane-keeping", "--docs", "docs.md"]
    out, _ = run_main(program, tmp_path, *options)
    rows = json.loads((tmp_path / "out" / "comparison.json").read_text("utf-8"))["rows"]
    assert [(row["policy"], row["budget"]) for row in rows] == [
        ("lane-keeping", ""),
        ("ippo", "400 transitions"),
        ("ippo", "0.1 s"),
    ]
    # Who keeps the lane never changes it, and no cost hides that.
    assert rows[0]["success_rate"]["value"] == 0.0
    assert rows[0]["cost_ratio"]["value"] is None
    first, second = (row["transitions"][0] for row in rows[1:])
    assert first >= 400
    assert not is_pretended or (first, second) == (409, 809)
    assert rows[1]["transitions_to_good"] == [None]
    assert min(row[f"microseconds_of_{size}"][0] for row in rows for size in (1, 64)) > 0.0
    text = docs.read_text("utf-8")
    assert text.startswith(f"before\n{BEGIN}\n\n| policy | budget | success [%] |")
    assert text.endswith(f"|\n\n{END}\nafter\n")
    assert "old" not in text
    assert "| lane-keeping | - | 0.0 [0.0, " in text
    assert text.count("| ippo |") == out.count("| ippo |") == 2
    with (tmp_path / "out" / "comparison.csv").open(newline="", encoding="utf-8") as file:
        assert [row["policy"] for row in csv.DictReader(file)] == ["lane-keeping", "ippo", "ippo"]
    # What is measured of a run is kept with it.
    monkeypatch.setattr(program, "measure", None)
    docs.write_text(f"{BEGIN}\n{END}", "utf-8")
    again, _ = run_main(program, tmp_path, *options, "--report")
    assert again == out
    assert docs.read_text("utf-8") == f"{BEGIN}\n\n{out}\n{END}"
    again, _ = run_main(program, tmp_path, *options[:-4], "--policies")
    assert again.splitlines()[-2:] == out.splitlines()[-2:]


def test_what_is_measured_at_a_time_keeps_its_place(program, monkeypatch):
    """Threads instead of processes, for the program is no module here."""
    monkeypatch.setattr(program, "get_context", {"spawn": multiprocessing.dummy}.get)
    monkeypatch.setattr(program, "measure_run", lambda folder, *_: folder)
    monkeypatch.setattr(program, "make_policy", lambda name, *_: name)
    monkeypatch.setattr(program, "measure", lambda policy, *_: policy)
    options = program.parse(["--processes", "3"])
    tasks = [program.Task("ippo", "400 transitions", Path(str(number))) for number in range(20)]
    tasks += [program.Task("quintic", "", None)]
    found = program.measure_all(tasks, options)
    assert found == [*(Path(str(number)) for number in range(20)), "quintic"]


def test_without_seconds_there_is_one_budget(program, tmp_path, monkeypatch):
    monkeypatch.setattr(program, "carry_out", pretend)
    options = ["--output", str(tmp_path), "--seeds", "0", "--algorithms", "naf", "ippo"]
    arguments = program.parse([*options, "--transitions", "1000", "--seconds", "0"])
    found = program.train(arguments)
    assert [*found] == [("naf", "1000 transitions"), ("ippo", "1000 transitions")]
    # A minute for the 800 that were collected in 0.1 s, and again as many demonstrations.
    run = program.plan(arguments, "naf", 0, "transitions", 1000)
    arguments.seconds = 60.0
    assert program.count_affordable(arguments, "naf", run, 1000) == 200 + 480_000


def test_a_training_that_took_other_seconds_is_trained_again_at_its_own_speed(
    program, tmp_path, monkeypatch
):
    """Other programs ran beside the first training of one seed, not of the other."""
    options = program.parse(["--output", str(tmp_path), "--seconds", "10"])
    speeds = {"ippo-transitions-0": 50.0, "ippo-transitions-1": 100.0}

    def carry_out(runs, folder, *, num_processes):
        assert num_processes == 1
        for run in runs:
            count = int(dict(one.split("=") for one in run.arguments[1:])[TOTAL])
            (folder / run.name).mkdir(exist_ok=True)
            seconds = count / speeds.get(run.name, 100.0)
            write_json(folder / run.name / "training.json", {"seconds_training": seconds})
        return True

    monkeypatch.setattr(program, "carry_out", carry_out)
    first = {}
    for seed in (0, 1):
        first["ippo", seed] = program.plan(options, "ippo", seed, "transitions", 150_000)
    carry_out(first.values(), tmp_path, num_processes=1)
    found = program.train_for_seconds(options, first)
    names = {member: run.name for member, run in found.items()}
    assert names == {("ippo", 0): "ippo-seconds-again-0", ("ippo", 1): "ippo-seconds-1"}
    for run in found.values():
        assert f"{TOTAL}=1000" in run.arguments
    # One that never takes them is not trained for ever.
    monkeypatch.setattr(program, "is_in_time", lambda *_: False)
    assert program.train_for_seconds(options, first)["ippo", 1].name == "ippo-seconds-again-again-1"


def test_a_saved_model_is_good_only_if_it_succeeds(program, tmp_path, monkeypatch):
    """A low cost of the few changes that are completed is none."""
    scenario = load_scenario("paper")
    options = program.parse([])
    found = {"return": [-4.0, -5.0], "optimal_return": [-4.0, -4.0], "road": [0, 1]}
    models = dict.fromkeys(("step_000000100", "step_000000300"), (1.0, 0.0))
    models["step_000000200"] = (1.0, 1.0)
    asked = []

    def drive(name, *_):
        asked.append(name)
        return {**found, "success_rate": models[Path(name).stem]}

    monkeypatch.setattr(program, "drive", drive)
    monkeypatch.setattr(program, "make_policy", lambda name, *_: name)
    monkeypatch.setattr(program, "measure", lambda *_: {"maneuvers": {}})
    (tmp_path / "checkpoints").mkdir()
    for name in models:
        (tmp_path / "checkpoints" / f"{name}.pt").touch()
    write_json(tmp_path / "training.json", {"seconds_training": 3.0})
    (tmp_path / "metrics.csv").write_text("transitions\n250\n", "utf-8")
    # Those of the demonstrations count, too.
    text = "demonstrations: {num_transitions: 50}\n"
    (tmp_path / "config.yaml").write_text(text, "utf-8")
    result = program.measure_run(tmp_path, scenario, options)
    assert result == {
        "maneuvers": {},
        "asked": {"maneuvers": 1000, "saved_maneuvers": 200},
        "transitions_to_good": 250,
        "training_seconds": 3.0,
        "transitions": 300,
    }
    assert len(asked) == 2
    assert program.measure_run(tmp_path, scenario, options) == result
    assert len(asked) == 2
    # Other maneuvers than those that were kept.
    options.saved_maneuvers = 3
    program.measure_run(tmp_path, scenario, options)
    assert len(asked) == 4


def test_whatever_falls_falls_over_the_whole_budget(program):
    options = program.parse([])
    run = program.plan(options, "naf-scratch", 2, "transitions", 50_000)
    assert (run.name, run.program) == ("naf-scratch-transitions-2", "agents/naf/train.py")
    assert {
        "seed=2",
        "demonstrations.num_transitions=0",
        "collector.total_transitions=50000",
        "evaluation.save_interval=5000",
        "evaluation.criterion=null",
        "optimizer.pretraining_transitions=18750",
        "exploration.annealing_transitions=50000",
    } <= set(run.arguments)
    # Demonstrations are a part of the budget.
    for budget, demonstrated in ((50_000, 10_000), (150_000, 20_000)):
        run = program.plan(options, "naf", 2, "transitions", budget)
        assert {
            f"demonstrations.num_transitions={demonstrated}",
            f"collector.total_transitions={budget - demonstrated}",
            f"exploration.annealing_transitions={budget - demonstrated}",
        } <= set(run.arguments)
    train = load_program(FOLDER / "baselines" / "train.py")
    for algorithm in options.algorithms:
        if algorithm.startswith("naf"):
            continue
        run = program.plan(options, algorithm, 0, "transitions", 50_000)
        config = train.read(run.arguments[0], run.arguments[1:])
        assert config.collector.total_transitions == 50_000
        if hasattr(config.exploration, "annealing_transitions"):
            assert config.exploration.annealing_transitions == 50_000


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--algorithms", "--policies"], "--algorithms, --policies: must name something"),
        (["--seconds", "-1"], "--seconds = -1.0: must be 0 or more"),
        (["--seconds", "nan"], "--seconds = nan: must be 0 or more"),
        (["--algorithms", "ppo2"], "argument --algorithms: invalid choice: 'ppo2'"),
        (["--policies", "nobody"], "checkpoint nobody: cannot be read"),
        (["--scenario", "nope"], "scenario 'nope': no such scenario"),
        (["--report", "--output", "nope"], "[Errno 2]"),
        (["--docs", "absent.md"], "[Errno 2]"),
        (["--docs", "empty.md"], "document 'empty.md': must have the lines"),
    ],
)
def test_a_bad_call_is_one_line(program, tmp_path, monkeypatch, capsys, options, message):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "empty.md").touch()
    with pytest.raises(SystemExit) as caught:
        program.main(options)
    assert caught.value.code == 2
    err = capsys.readouterr().err
    assert err.startswith(f"error: {message}")
    assert len(err.splitlines()) == 1
    assert [path.name for path in tmp_path.iterdir()] == ["empty.md"]
