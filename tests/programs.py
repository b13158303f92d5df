"""The programs of agents/ in this process, and busy roads on which they are soon done."""

import contextlib
import importlib.util
import io
import sys

BUSY = """
name: busy
num_agents: 4
horizon: 60.0
num_slots: 4
warmup: [20.0, 30.0]
road: {length: 400.0}
departures: {interval: [1.5, 3.0]}
command: {probability: 1.0}
"""
"""A scenario's file: an evaluation of a few maneuvers takes some hundred steps."""


def load_program(path):
    """The program as a module."""
    spec = importlib.util.spec_from_file_location(f"{path.parent.name}_{path.stem}", path)
    module = importlib.util.module_from_spec(spec)
    # Dataclasses look their module up.
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


def replaced(options):
    """The options without those whose field a later one gives again."""
    last = {option.partition("=")[0].lstrip("+"): option for option in options}
    return list(last.values())


def run_main(program, folder, *options):
    """Run the program in a folder; what it prints to stdout and stderr."""
    out, err = io.StringIO(), io.StringIO()
    with (
        contextlib.chdir(folder),
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
    ):
        program.main(replaced(options))
    return out.getvalue(), err.getvalue()
