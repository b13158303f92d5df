"""The shipped YAML files."""

from pathlib import Path

import numpy as np
import pytest
import yaml
from staging import damped_actions

from marl_lanes.scenario import Scenario, list_scenarios, load_scenario
from marl_lanes.traffic.simulator import Simulator


@pytest.mark.parametrize("name", list_scenarios())
def test_every_shipped_scenario_loads_and_runs(name):
    scenario = load_scenario(name)
    assert scenario.name == name
    assert scenario.description.endswith(".")
    simulator = Simulator(name, 2, seed=1)
    simulator.reset()
    for _ in range(200):
        simulator.step(damped_actions(simulator))
    assert np.isfinite(simulator.vehicles["position"]).all()
    assert simulator.roads["num_commands"].sum() > 0
    assert np.isfinite(simulator.state.observations).all()
    assert simulator.roads["num_collisions"].sum() == 0


def test_the_paper_is_the_schemas_defaults_and_says_every_field_that_counts():
    paper = load_scenario("paper")
    defaults = Scenario(name="paper", description=paper.description)
    assert paper == defaults
    file = Path(__file__).parents[2] / "scenarios" / "paper.yaml"
    spelled = yaml.safe_load(file.read_text(encoding="utf-8"))
    dumped = defaults.model_dump(mode="json")
    assert set(dumped) - set(spelled) == {"name"}
    for name, value in spelled.items():
        if isinstance(value, dict):
            unsaid = {field: dumped[name][field] for field in set(dumped[name]) - set(value)}
            # A road without arcs need not say so, nor a reward that a term has the weight 0.
            assert all(not default for default in unsaid.values()), unsaid


def test_a_scenario_survives_its_own_dump():
    for name in list_scenarios():
        scenario = load_scenario(name)
        assert load_scenario(scenario.model_dump(mode="json")) == scenario
        assert load_scenario(scenario, {}) is scenario
