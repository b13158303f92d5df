"""Which scenarios have episodes of agents, and which of them look the same to a learner."""

from collections.abc import Sequence

from marl_lanes.envs.vehicle_table import state_columns
from marl_lanes.scenario import Scenario, ScenarioError
from marl_lanes.traffic.roles.role import Role


def count_agents(scenario: Scenario) -> int:
    """Changers of an episode.

    Raises:
        ScenarioError: an episode would have no end, or no agent.
    """
    if scenario.num_agents is None or scenario.command.probability == 0.0:
        raise ScenarioError(
            f"scenario {scenario.name!r}: an episode needs num_agents (is {scenario.num_agents}) "
            f"and command.probability > 0 (is {scenario.command.probability})"
        )
    return scenario.num_agents


def check_spaces(changed: Scenario, made: Scenario, roles: Sequence[Role]) -> None:
    """Refuse a scenario for a reset that has other names or spaces than the environment.

    Args:
        changed: the scenario of the next episode.
        made: the one with which the environment was made.
        roles: of its agents.

    Raises:
        ScenarioError: they differ in what names and spaces follow from, or its episodes would have
            no agent.
    """
    is_same = all(
        role.seen(changed) == role.seen(made) and role.act(changed) == role.act(made)
        for role in roles
    )
    sizes = [
        (count_agents(one), one.max_vehicles, one.time_step, state_columns(one))
        for one in (changed, made)
    ]
    if not is_same or sizes[0] != sizes[1]:
        raise ScenarioError(
            "options['overrides']: num_agents, max_vehicles, time_step, observations, actions and "
            "the columns of the state must be those that the environment was made with"
        )
