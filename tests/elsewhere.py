"""A stand-in for a GPU where there is none: torch's device "meta", which has shapes and no data."""

import torch
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves

ELSEWHERE = torch.device("meta")


class NoHost(TorchDispatchMode):
    """A block in which no operator may read or write a tensor of the host.

    On a GPU it would wait for a copy, or could not be captured. A number that is read from a tensor
    fails by itself: there is none.
    """

    def __torch_dispatch__(self, func, types, args=(), kwargs=None):
        kwargs = kwargs or {}
        found = func(*args, **kwargs)
        for tensor in tree_leaves((args, kwargs, found)):
            if isinstance(tensor, torch.Tensor) and tensor.device != ELSEWHERE:
                raise AssertionError(f"{func}: a tensor of the host, {tuple(tensor.shape)}")
        return found
