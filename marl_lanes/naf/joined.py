"""Tensors side by side in one: what an optimiser or a target's update does to them is one call."""

from collections.abc import Sequence

import torch
from torch import Tensor, nn


def join(tensors: Sequence[Tensor]) -> Tensor:
    """One tensor, (n,), of which the given ones become views, with their values and shapes.

    They stay the objects that they are, for whoever holds them. Move them to their device before.
    """
    whole = torch.cat([tensor.detach().flatten() for tensor in tensors])
    with torch.no_grad():
        for tensor, part in zip(tensors, _split(whole, tensors), strict=True):
            place = part.storage_offset(), part.size(), part.stride()
            tensor.set_(whole.untyped_storage(), *place)
    return whole


def join_parameters(parameters: Sequence[nn.Parameter]) -> nn.Parameter:
    """The same for parameters; their gradients become views of its gradient, which starts at 0.

    Set that to 0 before each backward, with `zero_()`: theirs must not become None.
    """
    whole = nn.Parameter(join(parameters))
    whole.grad = torch.zeros_like(whole)
    for parameter, part in zip(parameters, _split(whole.grad, parameters), strict=True):
        parameter.grad = part
    return whole


def joined_runs(tensors: Sequence[Tensor]) -> list[list[int]]:
    """The places of contiguous tensors one behind the other in one storage, run by run."""
    runs: list[list[int]] = []
    end = None
    for place in sorted(range(len(tensors)), key=lambda place: tensors[place].data_ptr()):
        tensor = tensors[place]
        storage = tensor.untyped_storage().data_ptr()
        is_contiguous = tensor.is_contiguous()
        if (storage, tensor.data_ptr()) == end and is_contiguous:
            runs[-1].append(place)
        else:
            runs.append([place])
        end = (storage, tensor.data_ptr() + tensor.nbytes) if is_contiguous else None
    return runs


def whole_of(run: Sequence[Tensor]) -> Tensor:
    """The tensor, (n,), that the tensors of a run fill."""
    first = run[0].detach()
    return first.as_strided((sum(tensor.numel() for tensor in run),), (1,))


def take_side_by_side(tensors: Sequence[Tensor], place: Tensor) -> Tensor:
    """The tensors' numbers in one, (n,): themselves if they fill one, otherwise copied to a place.

    Args:
        tensors: any.
        place: (n,).
    """
    if joined_runs(tensors) == [[*range(len(tensors))]]:
        return whole_of(tensors)
    return torch.cat([tensor.flatten() for tensor in tensors], out=place)


def _split(whole: Tensor, like: Sequence[Tensor]) -> list[Tensor]:
    parts = whole.split([tensor.numel() for tensor in like])
    return [part.view(tensor.shape) for part, tensor in zip(parts, like, strict=True)]
