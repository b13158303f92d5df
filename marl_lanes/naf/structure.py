"""The base class of all structures of the greedy action mu(s)."""

from collections.abc import Sequence

import torch
from torch import Tensor, nn


class Mu(nn.Module):
    """A structure of the greedy action.

    Attributes:
        inside_box: the action is inside the box for all parameters and observations, so the
            maximum of Q over the box is V.
        needs: names of the observation columns that the formula reads.
    """

    inside_box = True
    needs: tuple[str, ...] = ()

    def __init__(self, name: str, features: Sequence[str]) -> None:
        super().__init__()
        for feature in self.needs:
            if feature not in features:
                raise ValueError(
                    f"mu {name!r} needs the feature {feature!r}, got {', '.join(features)}"
                )
        self.columns = [list(features).index(feature) for feature in self.needs]

    def act(self, observation: Tensor, normalised: Tensor) -> tuple[Tensor, Tensor]:
        """The greedy action mu and the slope of the cost |a| at mu, (..., action_dim) each.

        The slope is a subgradient: the sign of mu if mu is not 0, else any value in [-1, 1]. A
        structure whose mu can be exactly 0 returns there how near mu is to leaving 0.
        """
        mu = self(observation, normalised)
        return mu, torch.sign(mu)

    def read(self, observation: Tensor) -> list[Tensor]:
        """The columns that the formula needs, each (..., 1), in the order of `needs`."""
        return [observation[..., column : column + 1] for column in self.columns]
