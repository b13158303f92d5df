"""The loss of normalized advantage functions in few large kernels, for a GPU."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import torch
from torch import Tensor

from marl_lanes.naf.batched import ROWS_PER_CHUNK, BatchedNetworks, Networks
from marl_lanes.naf.layers import Heads
from marl_lanes.naf.loss import NAFLoss


class BatchedNAFLoss(NAFLoss):
    """`NAFLoss`, but all networks that read the encoded observation are evaluated together.

    Values and gradients are those of `NAFLoss` to rounding. `batch_networks` says how; before it
    is called, and for rows that it does not fit, the loss is `NAFLoss` as it is.
    """

    def __init__(self, *args: object, **kwargs: object) -> None:
        super().__init__(*args, **kwargs)  # type: ignore[arg-type]
        self.batches: dict[bool, BatchedNetworks] = {}
        self.heads: list[Heads] = []

    def batch_networks(self, batch_size: int) -> None:
        """Evaluate networks together from now on.

        Together are M, the target's V, and all `Heads` of the form of V that get the encoded
        observation itself, as one trial call shows: others, such as the gains of "cascade-gated",
        are evaluated alone. Nothing changes if mu can leave the box, for then the target is not V.

        Call it when parameters and targets are where they stay: joined, on their device.

        Args:
            batch_size: rows of a batch. Other numbers that are no multiple of the same chunks, and
                rows of several dimensions, are evaluated as by `NAFLoss`.
        """
        network = self.value_network
        if not network._mu_inside_box:
            return
        num_chunks = batch_size // ROWS_PER_CHUNK if batch_size % ROWS_PER_CHUNK == 0 else 1
        targets = dict(self.target_value_network_params["value"].items())
        following = [Networks(network.value, targets)]
        widths = following[0].widths[:-1]
        parts = [Networks(heads, dict(heads.named_parameters())) for heads in self._find_readers()]
        parts = [part for part in parts if part.widths[:-1] == widths]
        # In the order of the optimiser's parameters: those of mu, which may be frozen, last.
        of_mu = {*network.mu.modules()}
        order = [*network.modules()]
        parts.sort(key=lambda part: (part.heads in of_mu, order.index(part.heads)))
        critic = [part for part in parts if part.heads not in of_mu]
        self.heads = [part.heads for part in parts]
        self.batches = {
            mu_frozen: BatchedNetworks(
                critic if mu_frozen else parts,
                parts[len(critic) :] if mu_frozen else [],
                following,
                num_chunks=max(1, num_chunks),
            )
            for mu_frozen in (False, True)
        }

    def _evaluate(
        self, observation: Tensor, action: Tensor, following: Tensor
    ) -> tuple[Tensor, Tensor]:
        network = self.value_network
        batch = self.batches.get(network.mu_frozen)
        if batch is None or observation.ndim != 2 or len(observation) % batch.num_chunks:
            return super()._evaluate(observation, action, following)
        encoded = network._encode(observation)
        with torch.no_grad():
            encoded_following = network._encode(following, self.target_value_network_params)
        *outputs, next_value = batch(encoded, encoded_following)
        with _given(self.heads, encoded, outputs):
            return network._action_value(observation, encoded, action), next_value

    @torch.no_grad()
    def _find_readers(self) -> list[Heads]:
        """The networks that get the encoded observation itself."""
        network = self.value_network
        action = network.box.low[None]
        observation = action.new_zeros(1, len(network.features))
        encoded = network._encode(observation)
        found: list[Heads] = []

        def note(module: torch.nn.Module, given: tuple[Tensor, ...]) -> None:
            if isinstance(module, Heads) and given[0] is encoded:
                found.append(module)

        hooks = [
            module.register_forward_pre_hook(note)
            for module in network.modules()
            if isinstance(module, Heads)
        ]
        try:
            network._action_value(observation, encoded, action)
        finally:
            for hook in hooks:
                hook.remove()
        return found


@contextmanager
def _given(heads: Sequence[Heads], encoded: Tensor, outputs: Sequence[Tensor]) -> Iterator[None]:
    """Networks that return these outputs for that input."""
    for one, output in zip(heads, outputs, strict=True):
        one.given = encoded, output
    try:
        yield
    finally:
        for one in heads:
            one.given = None
