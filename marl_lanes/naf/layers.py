"""What the networks of V, M and mu are made of: the box of actions, and tanh networks."""

import itertools
from collections.abc import Sequence

import torch
from tensordict import TensorDictBase
from torch import Tensor, nn

from marl_lanes.naf.torch_internals import tensors_by_name


class ActionBox(nn.Module):
    """The box low <= a <= high of admissible actions.

    Args:
        low: lower bounds, (action_dim,), in action units.
        high: upper bounds, (action_dim,), each above its lower bound.

    Raises:
        ValueError: the bounds are not two finite, ordered vectors of one length.
    """

    low: Tensor
    high: Tensor

    def __init__(self, low: Sequence[float] | Tensor, high: Sequence[float] | Tensor) -> None:
        super().__init__()
        lower, upper = (torch.as_tensor(bound, dtype=torch.float32) for bound in (low, high))
        if lower.ndim != 1 or lower.shape != upper.shape or not lower.numel():
            raise ValueError(
                "action_low and action_high must be vectors of one length, "
                f"got shapes {tuple(lower.shape)} and {tuple(upper.shape)}"
            )
        if not (torch.isfinite(upper - lower) & (lower < upper)).all():
            raise ValueError(f"need finite action_low < action_high, got {low} and {high}")
        self.register_buffer("low", lower)
        self.register_buffer("high", upper)

    @property
    def half_range(self) -> Tensor:
        """(high - low) / 2, (action_dim,), in action units."""
        return (self.high - self.low) / 2

    @property
    def centre(self) -> Tensor:
        """(high + low) / 2, (action_dim,), in action units."""
        return (self.high + self.low) / 2

    def only(self, index: int) -> "ActionBox":
        """The bounds of one action, a copy."""
        return ActionBox(self.low[index : index + 1].clone(), self.high[index : index + 1].clone())

    def forward(self, action: Tensor) -> Tensor:
        """The nearest point of the box, (..., action_dim)."""
        return action.clamp(self.low, self.high)


class Heads(nn.Module):
    """Tanh networks side by side, whose outputs start near given values, whatever the input.

    They have no weights in common; one batched product a layer evaluates them together, which for
    networks of this size costs little more than one of them. Weights are (networks, in, out) and
    biases (networks, 1, out); a single network's are (in, out) and (out,). All are float32.

    Args:
        in_features: length of the input.
        hidden_sizes: widths of the hidden layers of each network.
        initial: initial outputs, for each network the same number of them.

    Attributes:
        given: an input, and the outputs that are returned for that very tensor: where networks are
            evaluated together (`BatchedNAFLoss`). None: no such input.
    """

    # Small, not zero: with zero weights the hidden layers would get no gradient at first.
    LAST_GAIN = 0.01

    def __init__(
        self, in_features: int, hidden_sizes: Sequence[int], initial: Sequence[Sequence[float]]
    ) -> None:
        super().__init__()
        self.initial = [list(values) for values in initial]
        widths = [in_features, *hidden_sizes, len(self.initial[0])]
        self.num_layers = len(widths) - 1
        self.given: tuple[Tensor, Tensor] | None = None
        self.names = [(f"weight_{layer}", f"bias_{layer}") for layer in range(self.num_layers)]
        self.flat_names = list(itertools.chain.from_iterable(self.names))
        for names, (fan_in, fan_out) in zip(self.names, itertools.pairwise(widths), strict=True):
            shapes: Sequence[tuple[int, ...]] = ((fan_in, fan_out), (fan_out,))
            if len(initial) > 1:
                shapes = ((len(initial), fan_in, fan_out), (len(initial), 1, fan_out))
            for name, shape in zip(names, shapes, strict=True):
                self.register_parameter(name, nn.Parameter(torch.empty(shape, dtype=torch.float32)))
        self.reset_parameters()

    def layer(self, index: int) -> tuple[Tensor, Tensor]:
        """Weight and bias of a layer."""
        weight, bias = self.names[index]
        return getattr(self, weight), getattr(self, bias)

    @property
    def last_bias(self) -> Tensor:
        """Bias of the last layer."""
        return self.layer(self.num_layers - 1)[1]

    def reset_parameters(self) -> None:
        """Draws the weights anew and sets the last layer back to the initial outputs."""
        with torch.no_grad():
            for index in range(self.num_layers):
                weight, bias = self.layer(index)
                bound = weight.shape[-2] ** -0.5  # that of nn.Linear
                weight.uniform_(-bound, bound)
                bias.uniform_(-bound, bound)
            weight.mul_(self.LAST_GAIN)
            bias.copy_(torch.tensor(self.initial, dtype=torch.float32).reshape(bias.shape))

    def forward(self, observation: Tensor, params: TensorDictBase | None = None) -> Tensor:
        """(..., in_features) to (..., networks * outputs), network by network.

        Args:
            observation: (..., in_features).
            params: weights and biases to use instead of its own, by their names here.
        """
        if self.given is not None and params is None and observation is self.given[0]:
            return self.given[1]
        # A plain dict: look-ups in a tensordict take a good part of what the layers take.
        values = tensors_by_name(self, self.flat_names) if params is None else dict(params.items())
        rows = observation
        if observation.ndim != 2:
            rows = observation.flatten(end_dim=-2) if observation.ndim > 1 else observation[None]
        is_single = len(self.initial) == 1
        product = torch.addmm if is_single else torch.baddbmm
        hidden = rows if is_single else rows.expand(len(self.initial), -1, -1)
        for index, (weight, bias) in enumerate(self.names):
            if index:
                hidden = torch.tanh(hidden)
            hidden = product(values[bias], hidden, values[weight])
        if not is_single:
            hidden = columns_of(hidden)
        if observation.ndim == 2:
            return hidden
        return hidden.reshape(*observation.shape[:-1], hidden.shape[-1])


def columns_of(outputs: Tensor) -> Tensor:
    """(networks, rows, outputs) to (rows, networks * outputs), network by network."""
    # For networks of one output a view, for others a copy.
    return outputs.squeeze(-1).mT if outputs.shape[-1] == 1 else outputs.transpose(0, 1).flatten(1)
