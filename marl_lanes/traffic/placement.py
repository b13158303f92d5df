"""Roads in the memory of this computer or of a GPU, where there is room for them."""

import math
from typing import TYPE_CHECKING

from marl_lanes.memory import check_memory
from marl_lanes.scenario import Scenario
from marl_lanes.traffic.host import HostRoads
from marl_lanes.traffic.machine.graphics import find_memory
from marl_lanes.traffic.machine.state import allocate
from marl_lanes.traffic.parameters import Parameters, array_sizes
from marl_lanes.traffic.roles.changer import CHANGER

if TYPE_CHECKING:
    from marl_lanes.traffic.gpu import GpuRoads


def bytes_of_road(scenario: Scenario) -> int:
    """Memory of one road [bytes]: its part of the state and of the actions."""
    arrays = allocate(num_envs=0, **array_sizes(scenario)).arrays
    state = sum(array.itemsize * math.prod(array.shape[1:]) for array in arrays)
    return state + 8 * scenario.num_slots * (len(CHANGER.act(scenario)) + 1)


def place_on_host(
    scenario: Scenario, parameters: Parameters, num_envs: int, num_threads: int
) -> HostRoads:
    """Make empty roads in the computer's memory.

    Args:
        scenario: of the roads.
        parameters: its numbers.
        num_envs: E, the number of roads.
        num_threads: threads that share the roads.

    Raises:
        ValueError: there is no room for them.
    """
    check_memory("num_envs", num_envs, num_envs * bytes_of_road(scenario))
    state = allocate(num_envs=num_envs, **array_sizes(scenario))
    return HostRoads(state, parameters, len(CHANGER.act(scenario)), num_threads)


def place_on_gpu(
    scenario: Scenario, parameters: Parameters, num_envs: int, *, learner: int, gpu: int
) -> "GpuRoads":
    """Make empty roads in a GPU's memory.

    Args:
        scenario: of the roads.
        parameters: its numbers.
        num_envs: E, the number of roads.
        learner: as for ``GpuRoads``.
        gpu: its number.

    Raises:
        MissingExtraError: the extra ``gpu`` is not installed.
        ValueError: there is no such GPU, or no room for the roads.
    """
    check_memory("num_envs", num_envs, num_envs * bytes_of_road(scenario), *find_memory(gpu))
    # Imported here, because a simulation on processors needs no CUDA.
    from marl_lanes.traffic.gpu import GpuRoads

    road = allocate(num_envs=1, **array_sizes(scenario))
    num_actions = len(CHANGER.act(scenario))
    return GpuRoads(road, parameters, num_envs, num_actions=num_actions, learner=learner, gpu=gpu)
