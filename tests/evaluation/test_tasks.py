"""The tasks of the benchmark."""

import pytest
from configs import typed

from marl_lanes import list_scenarios
from marl_lanes.evaluation.tasks import SEED, TASKS


def test_the_tasks_are_shipped_scenarios():
    assert len(set(TASKS)) == 5
    assert set(TASKS) <= set(list_scenarios())


@pytest.mark.parametrize("recipe", ["fast", "interactive", "long", "paper"])
def test_no_recipe_trains_or_chooses_on_the_traffic_of_the_benchmark(recipe):
    config = typed(f"recipe={recipe}")
    used = {config.seed, config.evaluation.seed, config.evaluation.saved_models_seed}
    assert SEED not in used
