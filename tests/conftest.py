"""Fixtures for tests of more than one folder, and what a test without a marker may not do."""

import multiprocessing.process
import os
import re
import signal
import subprocess
import sys

import pytest

# Their assertions show values, as those of test files do.
pytest.register_assert_rewrite("browser.replays", "comparing", "envs.showing", "staging")
# Tests run in as many processes as there are cores: torch gets one thread in each.
os.environ.setdefault("OMP_NUM_THREADS", "1")
# A shell that starts the tests in the background has Ctrl-C ignored, and the programs that the
# tests interrupt would inherit that.
if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

MARKERS = ("training", "ray", "slow", "long")
"""Of the tests that `make check` leaves out."""
PROGRAM = re.compile(r"\b(agents|benchmarks)/\S*\.py\b")


def pytest_addoption(parser):
    parser.addoption("--long", action="store_true", help="run the tests that take minutes, too")


def is_quick(item):
    return not any(item.get_closest_marker(name) for name in MARKERS)


def pytest_collection_modifyitems(config, items):
    """Files with long tests first: else a long one at the end would find the others idle."""
    if not config.getoption("--long"):
        left_out = [item for item in items if item.get_closest_marker("long")]
        items[:] = [item for item in items if not item.get_closest_marker("long")]
        config.hook.pytest_deselected(items=left_out)
    long = {item.path for item in items if not is_quick(item)}
    items.sort(key=lambda item: item.path not in long)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item):
    """An unmarked test, with its fixtures, neither trains nor starts a program or a worker."""
    if not is_quick(item):
        return (yield)
    with pytest.MonkeyPatch.context() as patch:
        _refuse(patch, subprocess.Popen, "__init__", _runs_program)
        _refuse(patch, multiprocessing.process.BaseProcess, "start")
        module = sys.modules.get("marl_lanes.training.learner")
        if module is not None:
            _refuse(patch, module.Learner, "train")
        return (yield)


def _refuse(patch, owner, name, is_refused=lambda *_, **__: True):
    """Make a method fail the test for the arguments that are refused."""
    method = getattr(owner, name)

    def refuse(*arguments, **options):
        if is_refused(*arguments, **options):
            pytest.fail(f"{owner.__name__}.{name}: mark the test `training`")
        return method(*arguments, **options)

    patch.setattr(owner, name, refuse)


def _runs_program(_, command, *__, **___):
    parts = [command] if isinstance(command, str | os.PathLike) else command
    return any(PROGRAM.search(os.fspath(part)) for part in parts)


@pytest.fixture(scope="module")
def two_nodes():
    """The address of a Ray cluster of two nodes on loopback."""
    from ray_cluster import two_nodes

    with two_nodes() as address:
        yield address


@pytest.fixture(autouse=True)
def _no_modules_of_the_user():
    """What a test imports for its commands, workers of another test need not find."""
    yield
    from marl_lanes import plugins

    plugins.imported.clear()


@pytest.fixture
def no_display(monkeypatch):
    """A computer on which no window can be opened."""
    import pygame

    pygame.display.quit()
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER"):
        monkeypatch.delenv(name, raising=False)
    yield
    pygame.display.quit()


@pytest.fixture
def policy_file(tmp_path):
    """A checkpoint of a changers' network."""
    from checkpoints import save_trained

    return save_trained(tmp_path / "policy.pt")


@pytest.fixture
def small_zoo(tmp_path_factory, monkeypatch):
    """A zoo of a changer and a follower that are soon read, in place of the package's."""
    from checkpoints import write_zoo

    from marl_lanes.zoo import index

    monkeypatch.setattr(index, "FOLDER", tmp_path_factory.mktemp("zoo"))
    return write_zoo(index.FOLDER)
