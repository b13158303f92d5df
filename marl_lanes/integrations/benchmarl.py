"""A task of BenchMARL: the batched environment, normalised."""

from collections.abc import Callable
from typing import Any

from benchmarl.environments.common import TaskClass
from tensordict import TensorDictBase
from torchrl.data import Composite
from torchrl.envs import EnvBase, FlattenObservation, Transform

from marl_lanes.envs.batched import LaneChangeEnv
from marl_lanes.envs.transforms import normalising
from marl_lanes.traffic.machine.state import Outcome

_NO_HORIZON = 1000
"""Steps of an evaluation where an episode has no horizon."""


class LaneChangeTask(TaskClass):
    """Lane changes, for ``Experiment(task=...)``.

    The agents of a group are the slots of the environment: a slot gets a new agent when its command
    has ended. BenchMARL trains on every slot, also where nobody is in it; few slots and many
    commands waste less. ``log_info`` tells what became of the commands.

    Args:
        config: arguments of ``LaneChangeEnv``: ``scenario``, ``overrides``, ``has_state`` (then a
            centralised critic sees the state), and so on.
    """

    def __init__(self, config: dict[str, Any] | None = None) -> None:
        super().__init__("lane_change", config)

    def get_env_fun(
        self,
        num_envs: int,
        continuous_actions: bool,  # noqa: ARG002 - BenchMARL passes it
        seed: int | None,
        device: Any,
    ) -> Callable[[], EnvBase]:
        """A function that makes ``num_envs`` roads."""
        config = dict(self.config)
        scenario = config.pop("scenario", "paper")
        return lambda: LaneChangeEnv(scenario, num_envs, seed=seed, device=device, **config)

    def get_env_transforms(self, env: EnvBase) -> list[Transform]:
        """Those of ``normalise``; the state as a vector, which BenchMARL's networks take."""
        transforms = normalising(env)
        if env.has_state:
            transforms.append(FlattenObservation(-2, -1, in_keys=["state"]))
        return transforms

    def supports_continuous_actions(self) -> bool:
        """Actions are accelerations."""
        return True

    def supports_discrete_actions(self) -> bool:
        """Actions are not discrete."""
        return False

    def max_steps(self, env: EnvBase) -> int:
        """The scenario's horizon."""
        scenario = env.base_env.scenario
        return round(scenario.horizon / scenario.time_step) if scenario.horizon else _NO_HORIZON

    def has_render(self, env: EnvBase) -> bool:
        """Whether the config has a ``render_mode``."""
        return env.base_env.render_mode is not None

    def group_map(self, env: EnvBase) -> dict[str, list[str]]:
        """The slots of each group."""
        groups: dict[str, list[str]] = env.group_map
        return groups

    def observation_spec(self, env: EnvBase) -> Composite:
        """The observations alone."""
        spec = env.full_observation_spec_unbatched
        groups = {}
        for group in env.group_map:
            seen = spec[group, "observation"]
            groups[group] = Composite({"observation": seen.clone()}, shape=seen.shape[:1])
        return Composite(groups)

    def info_spec(self, env: EnvBase) -> Composite | None:  # noqa: ARG002
        """There is none."""
        return None

    def state_spec(self, env: EnvBase) -> Composite | None:
        """All vehicles, if the config has ``has_state``."""
        if not env.base_env.has_state:
            return None
        return Composite({"state": env.full_observation_spec_unbatched["state"].clone()})

    def action_spec(self, env: EnvBase) -> Composite:
        """Parts of the bounds."""
        return env.full_action_spec_unbatched

    def action_mask_spec(self, env: EnvBase) -> Composite | None:  # noqa: ARG002
        """There is none."""
        return None

    @staticmethod
    def env_name() -> str:
        """The name in BenchMARL's tables."""
        return "marl_lanes"

    @staticmethod
    def log_info(batch: TensorDictBase) -> dict[str, float]:
        """The mean return and the completed share of the commands that ended in the batch."""
        after = batch["next", "changers"]
        ended = after["done"].squeeze(-1)
        if not ended.any():
            return {}
        completed = after["outcome"][ended] == int(Outcome.COMPLETED)
        return {
            "collection/commands/return": after["command_reward"][ended].mean().item(),
            "collection/commands/completed": completed.float().mean().item(),
        }
