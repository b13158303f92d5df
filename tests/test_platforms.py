"""Names of the standard library that one system has and another lacks: what mypy knows of them."""

import os
from pathlib import Path

import pytest
from mypy import api

ROOT = Path(__file__).parents[1]


def missing(platform, *paths):
    """Lines about names that a system lacks, where no branch asks for the system."""
    options = ["--config-file=", "--cache-dir", os.devnull, "--platform", platform]
    # Other packages' code is theirs, and takes long.
    options += ["--follow-imports", "skip", "--ignore-missing-imports"]
    options += ["--namespace-packages", "--explicit-package-bases"]
    told, problem, _ = api.run([*options, *map(str, paths)])
    assert not problem
    return [line for line in told.splitlines() if "Module has no attribute" in line]


@pytest.mark.slow
@pytest.mark.parametrize("platform", ["darwin", "win32"])
def test_every_name_is_there_or_asked_for(platform, monkeypatch):
    monkeypatch.chdir(ROOT)
    assert missing(platform, "marl_lanes", "agents") == []


def test_a_name_that_is_missing_is_found(tmp_path):
    file = tmp_path / "file.py"
    file.write_text("import os, sys\nos.fork()\nif sys.platform != 'win32':\n    os.fork()\n")
    assert len(missing("win32", file)) == 1
    assert missing("darwin", file) == []
