"""Tanh networks that read the same input, evaluated together by one batched product a layer."""

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn
from torch.autograd.function import once_differentiable
from torch.nn.functional import pad

from marl_lanes.naf.joined import joined_runs, whole_of
from marl_lanes.naf.layers import Heads, columns_of

ROWS_PER_CHUNK = 128
"""Rows over which one product of a weight's gradient sums."""

_WIDTH_UNIT = 4
"""Widths are multiples of it: products of unaligned rows are slower on a GPU."""

_SATURATED = 20.0
"""Its tanh is 1 in float32, so that a layer gives the column of ones of the next one."""


class Networks(NamedTuple):
    """Networks of the form of `Heads`, with its parameters or others."""

    heads: Heads
    tensors: Mapping[str, Tensor]
    """By the names that the heads have for them."""

    @property
    def number(self) -> int:
        """How many networks they are."""
        return len(self.heads.initial)

    @property
    def layers(self) -> list[tuple[Tensor, Tensor]]:
        """Weight and bias of each layer."""
        return [(self.tensors[weight], self.tensors[bias]) for weight, bias in self.heads.names]

    @property
    def widths(self) -> list[int]:
        """Of the input, of the hidden layers, of the output."""
        weights = [weight for weight, _ in self.layers]
        return [weights[0].shape[-2], *(weight.shape[-1] for weight in weights)]

    @property
    def in_order(self) -> list[Tensor]:
        """All tensors, layer by layer."""
        return [tensor for layer in self.layers for tensor in layer]


class BatchedNetworks:
    """Networks of equal input and hidden widths, evaluated together, with the values of `Heads`.

    In each layer a network's bias is one more row of its weight, and its input has a column of
    ones for it. So biases cost no kernels of their own, forward or backward, and a sum over the
    batch is part of a product. That product, of a few thousand numbers from all rows, would keep
    few of a GPU's processors busy: it is made for chunks of rows at once, which are added after.

    The networks keep their parameters. What a layer needs is gathered from where they lie at each
    evaluation, and the gradients are gathered back, each by one kernel for all.

    Args:
        learning: those that get a gradient; their tensors are leaves.
        fixed: those that get none, and read the same input.
        following: those that get none, and read another input.
        num_chunks: of the rows, whose number is a multiple of it.

    Raises:
        ValueError: the widths differ.
    """

    def __init__(
        self,
        learning: Sequence[Networks],
        fixed: Sequence[Networks] = (),
        following: Sequence[Networks] = (),
        *,
        num_chunks: int = 1,
    ) -> None:
        self.parts = [*learning, *fixed, *following]
        inner = [part.widths[:-1] for part in self.parts]
        if any(widths != inner[0] for widths in inner):
            raise ValueError(f"need networks of equal input and hidden widths, got {inner}")
        self.num_chunks = num_chunks
        self.num_learning_parts = len(learning)
        self.num_learning, num_fixed, self.num_following = (
            sum(part.number for part in parts) for parts in (learning, fixed, following)
        )
        self.num_reading = self.num_learning + num_fixed
        self.sizes = [(part.number, part.widths[-1]) for part in self.parts]
        self.num_outputs = max(outputs for _, outputs in self.sizes)
        # The input has a column more, each hidden layer too; the last layer has none.
        inputs = [_rounded(width + 1) for width in inner[0]]
        shapes = list(pairwise([*inputs, self.num_outputs]))
        self.num_added = inputs[0] - inner[0][0]
        number = len(inputs)
        self.layer_shapes = [(self.num_reading + self.num_following, *shape) for shape in shapes]
        self.parameters = [one for part in learning for one in part.in_order]
        device = self.parameters[0].device
        added = [1.0] + [0.0] * (self.num_added - 1)
        self.added = torch.tensor(added, device=device)
        self.sources, starts = _find_sources([one for part in self.parts for one in part.in_order])
        # What is no parameter: a zero, and what becomes a one.
        zero = sum(source.numel() for source in self.sources)
        self.sources.append(torch.tensor([0.0, _SATURATED], device=device))
        self.places = torch.cat(
            [self._places(layer, starts, zero).flatten() for layer in range(number)]
        ).to(device)
        self.gradient_places = self._gradient_places().to(device)

    def __call__(self, given: Tensor, following: Tensor) -> list[Tensor]:
        """Evaluate all networks.

        Args:
            given: (rows, in_features), of those that learn and of the fixed ones.
            following: (rows, in_features), of the following ones.

        Returns:
            for each of the given parts what its `Heads` would return, (rows, networks * outputs);
            with a gradient for those that learn.
        """
        found: tuple[Tensor, ...] = _Evaluation.apply(self, given, following, *self.parameters)
        return list(found)

    def gather(self) -> list[Tensor]:
        """Weights of all networks layer by layer, (networks, in + bias, out), padded by zeros."""
        found = torch.cat(self.sources).index_select(0, self.places)
        layers = found.split([networks * rows * cols for networks, rows, cols in self.layer_shapes])
        return [layer.view(shape) for layer, shape in zip(layers, self.layer_shapes, strict=True)]

    def gather_gradients(self, products: Sequence[Tensor]) -> list[Tensor]:
        """Gradients of the parameters.

        Args:
            products: of each layer, (networks * chunks, in + bias, out), of those that learn.
        """
        whole = torch.cat([product.flatten() for product in products])
        found = whole.take(self.gradient_places).sum(0)
        parts = found.split([parameter.numel() for parameter in self.parameters])
        return [
            part.view(parameter.shape)
            for part, parameter in zip(parts, self.parameters, strict=True)
        ]

    def _places(self, layer: int, starts: Mapping[int, int], zero: int) -> Tensor:
        """Where the numbers of a layer are in the sources side by side."""
        places = torch.full(self.layer_shapes[layer], zero)
        begin = 0
        for part in self.parts:
            weight, bias = part.layers[layer]
            fan_in, fan_out = weight.shape[-2:]
            own = places[begin : begin + part.number]
            for tensor, place in (weight, own[:, :fan_in]), (bias, own[:, fan_in : fan_in + 1]):
                start = starts[id(tensor)]
                numbers = torch.arange(start, start + tensor.numel())
                place[..., :fan_out] = numbers.view(part.number, -1, fan_out)
            if layer < len(self.layer_shapes) - 1:
                own[:, fan_in, fan_out] = zero + 1
            begin += part.number
        return places

    def _gradient_places(self) -> Tensor:
        """Where a parameter's gradient is in the products side by side, (chunks, parameters)."""
        chunks, start = self.num_chunks, 0
        products = []
        for _, rows, columns in self.layer_shapes:
            shape = self.num_learning, chunks, rows, columns
            size = self.num_learning * chunks * rows * columns
            products.append(torch.arange(start, start + size).view(shape))
            start += size
        found, begin = [], 0
        for part in self.parts[: self.num_learning_parts]:
            for product, (weight, _) in zip(products, part.layers, strict=True):
                fan_in, fan_out = weight.shape[-2:]
                own = product[begin : begin + part.number].transpose(0, 1)[..., :fan_out]
                found += [own[:, :, :fan_in].flatten(1), own[:, :, fan_in].flatten(1)]
            begin += part.number
        return torch.cat(found, dim=1)


class _Evaluation(torch.autograd.Function):
    """The layers of `BatchedNetworks`, and their derivatives."""

    @staticmethod
    def forward(
        ctx: Any, batch: BatchedNetworks, given: Tensor, following: Tensor, *_: nn.Parameter
    ) -> tuple[Tensor, ...]:
        weights = batch.gather()
        inputs = torch.cat(
            [
                given.expand(batch.num_reading, -1, -1),
                following.expand(batch.num_following, -1, -1),
            ]
        )
        hidden = [torch.cat([inputs, batch.added.expand(*inputs.shape[:-1], -1)], dim=-1)]
        for weight in weights[:-1]:
            hidden.append(torch.tanh(torch.bmm(hidden[-1], weight)))
        outputs = torch.bmm(hidden[-1], weights[-1])
        ctx.batch = batch
        ctx.in_features = given.shape[-1]
        ctx.set_materialize_grads(False)
        ctx.save_for_backward(*hidden, *weights)
        parts = outputs.split([number for number, _ in batch.sizes])
        found = tuple(
            columns_of(part[..., :size]) for part, (_, size) in zip(parts, batch.sizes, strict=True)
        )
        ctx.mark_non_differentiable(*found[batch.num_learning_parts :])
        return found

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor | None) -> tuple[Tensor | None, ...]:
        batch, saved = ctx.batch, ctx.saved_tensors
        learning = batch.num_learning
        count = len(saved) // 2
        hidden = [one[:learning] for one in saved[:count]]
        weights = [one[:learning].mT for one in saved[count:]]
        rows = hidden[0].shape[1]
        parts = [*zip(gradients, batch.sizes, strict=True)][: batch.num_learning_parts]
        upstream = torch.cat(
            [
                _uncolumned(gradient, number, size, batch.num_outputs, hidden[0])
                for gradient, (number, size) in parts
            ]
        )
        chunks = learning * batch.num_chunks, rows // batch.num_chunks, -1
        products = []
        for layer in reversed(range(count)):
            inputs = hidden[layer].reshape(chunks)
            products.append(torch.bmm(inputs.mT, upstream.reshape(chunks)))
            if layer:
                upstream = torch.bmm(upstream, weights[layer])
                upstream = torch.ops.aten.tanh_backward(upstream, hidden[layer])
        of_input = None
        if ctx.needs_input_grad[1]:
            of_input = torch.bmm(upstream, weights[0]).sum(0)[:, : ctx.in_features]
        return None, of_input, None, *batch.gather_gradients(products[::-1])


def _uncolumned(
    gradient: Tensor | None, number: int, size: int, width: int, like: Tensor
) -> Tensor:
    """(rows, networks * outputs) to (networks, rows, width); 0 without a gradient."""
    rows = like.shape[1]
    if gradient is None:
        return like.new_zeros(number, rows, width)
    found = gradient.reshape(rows, number, size).transpose(0, 1)
    return found if size == width else pad(found, (0, width - size))


def _find_sources(tensors: Sequence[Tensor]) -> tuple[list[Tensor], dict[int, int]]:
    """The pieces of memory that hold the tensors, and where each begins in them side by side."""
    sources: list[Tensor] = []
    starts: dict[int, int] = {}
    end = 0
    for run in joined_runs(tensors):
        for place in run:
            starts[id(tensors[place])] = end
            end += tensors[place].numel()
        sources.append(whole_of([tensors[place] for place in run]))
    return sources, starts


def _rounded(width: int) -> int:
    return -(-width // _WIDTH_UNIT) * _WIDTH_UNIT
