"""The one place of NAF that uses names which torch does not promise to keep.

They save time in every update. They are looked for when this module is imported: without them what
is public gives the same, more slowly.
"""

from collections.abc import Iterable, Mapping, Sequence
from itertools import chain
from typing import Any

from torch import Tensor, nn

_TABLES = ("_parameters", "_buffers")
HAS_TABLES = all(isinstance(vars(nn.Module()).get(name), dict) for name in _TABLES)
"""Whether a module keeps its own parameters and buffers in tables by name."""


def _table(module: Any, place: int) -> dict[str, Tensor]:
    table: dict[str, Tensor] = getattr(module, _TABLES[place])
    return table


def tensors_by_name(module: nn.Module, names: Sequence[str]) -> Mapping[str, Tensor]:
    """A module's parameters, all of which have these names, or the tensors in their place.

    To look each up in the module takes a tenth of what a network of this size takes.
    """
    if HAS_TABLES and len(table := _table(module, 0)) == len(names):
        return table
    # Tensors that are no parameters have taken their place (TensorDict.to_module).
    return {name: getattr(module, name) for name in names}


class TensorsOf:
    """The parameters and the buffers of a module, found without a walk over it each time.

    Args:
        module: with its submodules, which stay.
    """

    def __init__(self, module: nn.Module) -> None:
        self.module = module
        self._owners = list(module.modules())

    @property
    def parameters(self) -> Iterable[Tensor]:
        """All parameters, in the order of the submodules."""
        return self._chain(0) if HAS_TABLES else self.module.parameters()

    @property
    def buffers(self) -> Iterable[Tensor]:
        """All buffers, in the order of the submodules."""
        return self._chain(1) if HAS_TABLES else self.module.buffers()

    def _chain(self, place: int) -> Iterable[Tensor]:
        return chain.from_iterable(_table(owner, place).values() for owner in self._owners)
