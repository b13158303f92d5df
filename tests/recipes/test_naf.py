"""The training of NAF before it begins: its configuration, its network, what is refused."""

from pathlib import Path

import numpy as np
import pytest
from naf_program import assert_same_weights, begin, prepare, read_tiny

from marl_lanes import ScenarioError, load_scenario
from marl_lanes.naf.checkpoint import greedy_policy, read_content
from marl_lanes.recipes.naf import read, start_network
from marl_lanes.traffic.roles.follower import FOLLOWER
from marl_lanes.training.checkpoint import make_network, save_checkpoint
from marl_lanes.training.config import write_config

pytestmark = pytest.mark.training
PAPER = load_scenario("paper")
collector_warnings = pytest.mark.filterwarnings(
    "ignore:Creating .* which inherits from WeightUpdaterBase:DeprecationWarning"
)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["scenario=nope"], "scenario 'nope': no such scenario"),
        (["seed=-1"], "seed = -1: must be greater than or equal to 0"),
        (["+training_overrides.road.lanes=3"], "road.lanes: unknown key"),
        (["network.mu=foo"], "foo"),
    ],
)
def test_what_is_refused_leaves_nothing_behind(tmp_path, monkeypatch, options, message):
    monkeypatch.chdir(prepare(tmp_path))
    with pytest.raises(ValueError, match="(?i)" + message.replace("(", r"\(")) as caught:
        begin(read_tiny(*options))
    assert len(str(caught.value).splitlines()) == 1
    assert [path.name for path in tmp_path.iterdir()] == ["busy.yaml"]


def test_a_resumed_run_may_have_another_cluster(tmp_path, monkeypatch):
    monkeypatch.chdir(prepare(tmp_path))
    config = read_tiny("collector=ray", "num_workers=2", "ray.address=10.0.0.1:1")
    assert config.ray.address == "10.0.0.1:1"
    write_config(tmp_path / "run" / "config.yaml", config)
    again = read(["resume=run", "ray.address=10.0.0.2:2"])
    assert (again.ray.address, again.num_workers) == ("10.0.0.2:2", 2)
    assert read(["resume=run"]).ray.address == "10.0.0.1:1"


def test_a_policy_of_the_zoo_is_an_initial_checkpoint(small_zoo, tmp_path, monkeypatch):
    monkeypatch.chdir(prepare(tmp_path))
    options = ["initial_checkpoint=zoo:paper", "network.mu=paper", "network.hidden_sizes=[8,4]"]
    network = start_network(read_tiny(*options), PAPER)
    assert_same_weights(read_content(small_zoo / "paper.pt")["weights"], network.state_dict())


@collector_warnings
def test_a_training_starts_from_demonstrations(tmp_path, monkeypatch):
    """mu has learned from the controller, and goes on from the run's own weights when resumed."""
    monkeypatch.chdir(prepare(tmp_path))
    few = ("demonstrations.num_transitions=60", "demonstrations.num_updates=200")
    config = read_tiny(*few, "network.mu=mlp", "network.knows_action_cost=false")
    learner = begin(config)
    assert learner.transitions == 0
    fitted = {name: value.clone() for name, value in learner.algorithm.network.state_dict().items()}
    greedy = greedy_policy(learner.algorithm.network)
    start = np.asarray([[20.0, 0.0, 3.75, 0.0, 0.0, 0.0]], np.float32)
    assert greedy(start)[0, 0] > 0.05
    learner.close()
    resumed = config.model_copy(update={"resume": "run", "seed": 1})
    learner = begin(resumed)
    assert_same_weights(fitted, learner.algorithm.network.state_dict())
    learner.close()


@pytest.mark.parametrize(
    ("network", "message"),
    [
        (None, r"i\.pt: cannot be read"),
        (
            make_network(PAPER, "mlp", [8], role=FOLLOWER),
            r"i\.pt: its features .* changers of .* 'busy'",
        ),
        (make_network(PAPER, "damped", [8]), r"network\.mu = 'cascade': must be 'damped'.*i\.pt"),
        (make_network(PAPER, "cascade", [9]), r"network\.hidden_sizes = \[8\]: must be \[9\]"),
        (
            make_network(PAPER, "cascade", [8], off_diagonal=False),
            r"network\.off_diagonal = True: must be False",
        ),
    ],
    ids=["none", "follower", "mu", "widths", "off_diagonal"],
)
def test_an_initial_checkpoint_that_does_not_fit(tmp_path, monkeypatch, network, message):
    monkeypatch.chdir(prepare(tmp_path))
    if network is not None:
        save_checkpoint(tmp_path / "i.pt", network, "paper", 3)
    before = set(tmp_path.iterdir())
    with pytest.raises(ValueError, match=message):
        begin(read_tiny("initial_checkpoint=i.pt"))
    assert set(tmp_path.iterdir()) == before


def test_a_scenario_with_two_actions_has_its_recipe(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("two.yaml").write_text("action: {longitudinal: {}}\n", encoding="utf-8")
    Path("one.yaml").write_text("num_slots: 8\n", encoding="utf-8")
    for named in (
        ["scenario=interactive"],
        ["seed=1", "scenario='two.yaml'"],
        ["scenario=two.yaml"],
    ):
        assert read(named).recipe == "interactive"
    for named in (
        [],
        ["seed=1"],
        ["scenario=lateral_only"],
        ["scenario=one.yaml"],
        ["recipe=fast", "scenario=interactive"],
    ):
        assert read(named).recipe == "fast"
    for named, scenario in (("scenario=absent", "absent"), ("scenario=3", "3")):
        with pytest.raises(ScenarioError, match=f"scenario '{scenario}.*': no such scenario"):
            read([named])
