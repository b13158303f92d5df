"""What a run was begun with: kept in its folder, and refused if it changes there."""

from pathlib import Path

import pytest
import yaml
from configs import typed
from systems import needs_links

from marl_lanes import load_scenario
from marl_lanes.scenario import ScenarioError
from marl_lanes.training.config import CONFIG_FILE, ConfigError
from marl_lanes.training.inputs import (
    LEARNED_FILE,
    SCENARIO_FILE,
    SUMS_FILE,
    check_inputs,
    find_scenario,
    keep_inputs,
    read_scenario,
)

LEARNED = {"followers": {"mix": {"learned": 1.0}, "learned": {"checkpoint": "followers.pt"}}}


@pytest.fixture
def run(tmp_path, monkeypatch):
    """A run folder with a copy of a checkpoint, in the working folder."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "followers.pt").write_bytes(b"weights")
    (tmp_path / "run").mkdir()
    scenario = load_scenario("paper", LEARNED)
    keep_inputs(tmp_path / "run", typed(), scenario, {LEARNED_FILE: tmp_path / "followers.pt"})
    return tmp_path / "run"


def test_every_field_of_the_scenario_is_kept(tmp_path):
    scenario = load_scenario("interactive", {"time_step": 0.05, "description": "a: 'b' # c\n1e6"})
    assert keep_inputs(tmp_path, typed(), scenario, {}) == scenario
    assert read_scenario(tmp_path) == scenario
    stored = yaml.safe_load((tmp_path / SCENARIO_FILE).read_text(encoding="utf-8"))
    assert stored.keys() == scenario.model_dump().keys()
    check_inputs(tmp_path, [])


def test_a_checkpoint_is_copied_and_the_scenario_names_the_copy(run, tmp_path, monkeypatch):
    (tmp_path / "followers.pt").unlink()
    assert (run / LEARNED_FILE).read_bytes() == b"weights"
    assert read_scenario(run).followers.learned.checkpoint == str(run / LEARNED_FILE)
    check_inputs(run, [LEARNED_FILE])
    # The folder can be moved, and read from anywhere.
    moved = run.rename(tmp_path / "moved")
    monkeypatch.chdir("/")
    assert read_scenario(moved).followers.learned.checkpoint == str(moved / LEARNED_FILE)


def test_a_policy_of_the_zoo_is_copied_too(small_zoo, tmp_path):
    scenario = load_scenario("paper", {"followers": {"learned": {"checkpoint": "zoo:adversary"}}})
    kept = keep_inputs(tmp_path, typed(), scenario, {LEARNED_FILE: Path("zoo:adversary")})
    assert (tmp_path / LEARNED_FILE).read_bytes() == (small_zoo / "adversary.pt").read_bytes()
    # A later version of the package may have another one.
    assert kept.followers.learned.checkpoint == str(tmp_path / LEARNED_FILE)
    assert read_scenario(tmp_path) == kept


def test_a_checkpoint_that_is_not_read_is_not_named(tmp_path):
    scenario = load_scenario("paper", {"followers": {"learned": {"checkpoint": "/etc/hostname"}}})
    kept = keep_inputs(tmp_path, typed(), scenario, {})
    assert kept.followers.learned.checkpoint is None
    assert read_scenario(tmp_path) == kept
    assert not (tmp_path / LEARNED_FILE).exists()


def test_the_checksums_are_those_of_sha256sum(run):
    lines = (run / SUMS_FILE).read_text(encoding="utf-8").splitlines()
    assert [line[64:] for line in lines] == [
        f"  {name}" for name in (CONFIG_FILE, SCENARIO_FILE, LEARNED_FILE)
    ]


@pytest.mark.parametrize("name", [CONFIG_FILE, SCENARIO_FILE, LEARNED_FILE])
@pytest.mark.parametrize("is_there", [True, False])
def test_a_file_that_has_changed_is_refused(run, name, is_there):
    content = bytearray((run / name).read_bytes())
    for place in range(0, len(content), max(1, len(content) // 20)):
        (run / name).unlink(missing_ok=True)
        content[place] ^= 1
        if is_there:
            (run / name).write_bytes(content)
        with pytest.raises(ConfigError, match=rf"resume = .*run': its {name} must be as when"):
            check_inputs(run, [LEARNED_FILE])
        content[place] ^= 1
    (run / name).write_bytes(content)
    check_inputs(run, [LEARNED_FILE])


@pytest.mark.parametrize("text", [None, b"", b"\xff", b"no sums\n"])
def test_checksums_that_are_damaged_or_gone_are_refused(run, text):
    (run / SUMS_FILE).unlink()
    if text is not None:
        (run / SUMS_FILE).write_bytes(text)
    with pytest.raises(ConfigError, match="resume = ") as caught:
        check_inputs(run, [LEARNED_FILE])
    assert len(str(caught.value).splitlines()) == 1


def test_a_folder_that_is_none_of_a_run_is_refused(tmp_path):
    for folder in (tmp_path, tmp_path / "absent"):
        with pytest.raises(ConfigError, match=r"must be a run folder; it has no scenario\.yaml"):
            find_scenario(folder)


def test_a_scenario_that_is_not_valid_is_refused(run):
    (run / SCENARIO_FILE).write_text("num_agents: many\n", encoding="utf-8")
    with pytest.raises(ScenarioError, match="num_agents = 'many'"):
        read_scenario(run)


@needs_links
def test_a_link_out_of_the_folder_is_refused(run):
    (run / "checkpoints").symlink_to("/etc")
    with pytest.raises(ConfigError, match="checkpoints: must be a file or a folder of its own"):
        read_scenario(run)
