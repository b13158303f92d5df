"""The index of the zoo, and the files that ship with the package."""

import hashlib
import json

import numpy as np
import pytest

from marl_lanes import load_scenario
from marl_lanes.envs.followers import load_follower
from marl_lanes.evaluation.benchmark import ENDINGS, Row, Training
from marl_lanes.evaluation.tasks import SEED
from marl_lanes.naf.checkpoint import greedy_policy, read_content
from marl_lanes.training.checkpoint import load_policy
from marl_lanes.zoo.index import (
    FOLDER,
    INDEX_FILE,
    PREFIX,
    ZooError,
    find_entry,
    find_file,
    read_index,
)

MAX_SIZE = 200_000
KNOWN = {"description", "role", "sha256", "version", "seed", "training", "rows"}
SHIPPED = list(read_index())


def test_there_are_policies_and_every_file_is_in_the_index():
    assert SHIPPED
    assert {path.name for path in FOLDER.iterdir() if path.suffix not in {".py", ""}} == {
        INDEX_FILE,
        *(f"{name}.pt" for name in SHIPPED),
    }


@pytest.mark.parametrize("name", SHIPPED)
def test_a_shipped_policy_is_small_and_drives_where_it_was_measured(name):
    entry, file = find_entry(name), find_file(PREFIX + name)
    assert entry.keys() == KNOWN
    assert file.stat().st_size < MAX_SIZE
    # The weights and what the network needs: nothing of the training.
    assert read_content(file).keys() == {"format", "config", "weights", "scenario", "transitions"}
    training = Training.model_validate(entry["training"])
    assert f"seed={entry['seed']}" in str(training.command).split()
    # A model that was chosen knows less than the whole training.
    assert training.transitions >= read_content(file)["transitions"]
    scenario = load_scenario(training.scenario)
    if entry["role"] == "follower":
        assert load_follower(file, scenario)(np.zeros((2, 9), np.float32)).shape == (2,)
    else:
        seen = np.zeros((2, len(scenario.observation.features)), np.float32)
        act = greedy_policy(load_policy(file, scenario).network)
        assert len(act(seen)) == 2


@pytest.mark.parametrize("name", SHIPPED)
def test_a_shipped_policy_was_measured_on_traffic_of_the_benchmark(name):
    for row in find_entry(name)["rows"]:
        found = Row.model_validate(row)
        assert found.seed == SEED
        assert found.num_maneuvers >= 1000
        shares = [found.statistics[key].value for key in ENDINGS]
        assert sum(shares) == pytest.approx(1.0)
        success = found.statistics["success_rate"]
        assert success.low <= success.value <= success.high


@pytest.mark.usefixtures("small_zoo")
@pytest.mark.parametrize("prefix", ["", PREFIX])
def test_a_name_has_its_file(small_zoo, prefix):
    assert find_file(f"{prefix}paper") == small_zoo / "paper.pt"
    assert find_entry(f"{prefix}adversary")["role"] == "follower"


@pytest.mark.usefixtures("small_zoo")
@pytest.mark.parametrize("name", ["absent", "zoo:absent", "zoo:", "zoo:../paper", "PAPER"])
def test_another_name_is_refused_with_those_that_there_are(name):
    for find in (find_entry, find_file):
        with pytest.raises(ZooError, match=r"allowed: zoo:paper, zoo:adversary$"):
            find(name)


def test_a_file_with_another_checksum_is_refused(small_zoo):
    file = small_zoo / "paper.pt"
    file.write_bytes((small_zoo / "adversary.pt").read_bytes())
    with pytest.raises(ZooError, match=r"paper\.pt is not the one of the index"):
        find_file("zoo:paper")
    index = json.loads((small_zoo / INDEX_FILE).read_text(encoding="utf-8"))
    index["paper"]["sha256"] = hashlib.sha256(file.read_bytes()).hexdigest()
    (small_zoo / INDEX_FILE).write_text(json.dumps(index), encoding="utf-8")
    assert find_file("zoo:paper") == file
