"""What a training needs of torch, whatever its caller has set."""

from collections.abc import Iterator
from contextlib import contextmanager

import torch


@contextmanager
def training_settings(device: torch.device) -> Iterator[None]:
    """Gradients, and float32 where TorchRL makes tensors of the default dtype.

    Args:
        device: where the networks learn.
    """
    before = torch.get_default_dtype()
    torch.set_default_dtype(torch.float32)
    try:
        with (
            torch.inference_mode(mode=False),
            torch.enable_grad(),
            torch.autocast(device.type, enabled=False),
        ):
            yield
    finally:
        torch.set_default_dtype(before)
