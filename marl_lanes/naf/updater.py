"""The target network's soft update, all parameters in one call."""

import torch
from torchrl.objectives import SoftUpdate


class ForeachSoftUpdate(SoftUpdate):
    """theta- += tau (theta - theta-), as `SoftUpdate` does it, with far less overhead.

    It takes the arguments of `SoftUpdate` and gives the same values. Like it, it holds on to the
    parameters that the loss has when it is built: move the loss to its device before.
    """

    def init_(self) -> None:
        """List the pairs of parameters, and copy the sources to the targets."""
        super().init_()
        keys = list(self._sources.keys(True, True))
        self._source_list = [self._sources[key] for key in keys]
        self._target_list = [self._targets[f"target_{key[0]}", *key[1:]] for key in keys]

    def step(self) -> None:
        """One update of every target parameter."""
        if not self.initialized:
            raise RuntimeError("the updater must be initialised, by init_(), before its first step")
        with torch.no_grad():
            torch._foreach_lerp_(self._target_list, self._source_list, 1 - self.eps)
