"""The target network's soft update, all parameters in one call."""

from torch import Tensor
from torch.optim.swa_utils import get_ema_multi_avg_fn
from torchrl.objectives import SoftUpdate

from marl_lanes.naf.joined import join, joined_runs, whole_of


class ForeachSoftUpdate(SoftUpdate):
    """theta- += tau (theta - theta-), as `SoftUpdate` does it, with far less overhead.

    It takes the arguments of `SoftUpdate` and gives the same values. Like it, it holds on to the
    parameters that the loss has when it is built: move the loss to its device before. The targets
    of parameters that are joined are joined, too.
    """

    def init_(self) -> None:
        """List the pairs of parameters, and copy the sources to the targets."""
        super().init_()
        keys = list(self._sources.keys(True, True))
        sources = [self._sources[key] for key in keys]
        targets = [self._targets[f"target_{key[0]}", *key[1:]] for key in keys]
        self._source_list: list[Tensor] = []
        self._target_list: list[Tensor] = []
        for run in joined_runs(sources):
            if len(run) == 1:
                self._source_list.append(sources[run[0]])
                self._target_list.append(targets[run[0]])
            else:
                self._source_list.append(whole_of([sources[place] for place in run]))
                self._target_list.append(join([targets[place] for place in run]))

    def step(self) -> None:
        """One update of every target parameter."""
        if not self.initialized:
            raise RuntimeError("the updater must be initialised, by init_(), before its first step")
        get_ema_multi_avg_fn(self.eps)(self._target_list, self._source_list, None)
