"""Run folders as a training leaves them before its conclusion."""

import json

from marl_lanes import load_scenario
from marl_lanes.training.checkpoint import make_network, save_checkpoint
from marl_lanes.training.config import EVALUATED
from marl_lanes.training.inputs import SCENARIO_FILE
from marl_lanes.training.run_folder import COMMAND_FILE, FINAL_MODEL, RunFolder


def trained(path, scenario="paper"):
    """A run whose models are all the untrained one."""
    loaded = load_scenario(scenario)
    run = RunFolder(path, ("loss",))
    run.config.write_text(f"scenario: {scenario}\n", encoding="utf-8")
    fields = json.dumps(loaded.model_dump(mode="json"))
    (path / SCENARIO_FILE).write_text(fields, encoding="utf-8")
    (path / COMMAND_FILE).write_text("python train.py\n", encoding="utf-8")
    run.times.write_text('{"seconds_training": 1.0}', encoding="utf-8")
    network = make_network(loaded, "cascade" if scenario == "paper" else "cascade+idm")
    for transitions in (0, 500, 1000):
        name = f"step_{transitions:09d}.pt"
        save_checkpoint(run.checkpoints / name, network, loaded.name, transitions)
        run.metrics.append((transitions, transitions, 0.5, 1, -4.0))
        run.maneuvers.append((transitions, -4.0, 1))
        run.evaluations.append((transitions, name, *(0.5 for _ in EVALUATED)))
    save_checkpoint(run.checkpoints / FINAL_MODEL, network, loaded.name, 1000)
    return run
