"""Observations of a few units and actions from -1 to 1, for TorchRL's learners."""

from typing import TYPE_CHECKING

import torch
from torch import Tensor
from torchrl.data import Bounded, Composite
from torchrl.envs import Compose, ObservationNorm, Transform, TransformedEnv

from marl_lanes.envs.actions import scale_action
from marl_lanes.envs.fit import network_form

if TYPE_CHECKING:
    from marl_lanes.envs.batched import LaneChangeEnv


class PartOfBound(Transform):
    """Actions as parts of their bounds: -1 is the lower one, 0 is 0, 1 the upper one.

    TorchRL's ``ActionScaling`` is affine: its 0 is the middle of the bounds, which brakes.

    Args:
        group: of the agents.
        low: lowest actions, (D,).
        high: highest actions, (D,).
    """

    def __init__(self, group: str, low: Tensor, high: Tensor) -> None:
        key = (group, "action")
        super().__init__(in_keys_inv=[key], out_keys_inv=[key])
        self.register_buffer("low", low)
        self.register_buffer("high", high)

    def _inv_apply_transform(self, action: Tensor) -> Tensor:
        scaled: Tensor = scale_action(action, self.low, self.high)
        return scaled

    def transform_input_spec(self, input_spec: Composite) -> Composite:
        """The action's spec with bounds of -1 and 1."""
        (key,) = self.in_keys_inv
        spec = input_spec["full_action_spec", *key]
        ones = torch.ones_like(spec.space.low)
        input_spec["full_action_spec", *key] = Bounded(
            -ones, ones, spec.shape, device=spec.device, dtype=spec.dtype
        )
        return input_spec


def normalise(env: "LaneChangeEnv") -> TransformedEnv:
    """The environment with the features less their offsets, divided by their scales.

    Actions are parts of their bounds, -1 to 1; beyond that they are clipped. As the PettingZoo
    environment with ``normalised``, but for the rows of absent slots, which are not zero.
    """
    return TransformedEnv(env, Compose(*normalising(env)))


def normalising(env: "LaneChangeEnv") -> list[Transform]:
    """The transforms of ``normalise``."""
    transforms: list[Transform] = []
    for role in env.roles:
        form = {
            key: torch.tensor(value, device=env.device)
            for key, value in network_form(role, env.scenario).items()
            if key != "features"
        }
        key = (role.group, "observation")
        transforms += [
            ObservationNorm(
                form["offsets"], form["scales"], in_keys=[key], out_keys=[key], standard_normal=True
            ),
            PartOfBound(role.group, form["action_low"], form["action_high"]),
        ]
    return transforms
