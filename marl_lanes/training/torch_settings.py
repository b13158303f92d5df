"""What a training needs of torch, whatever its caller has set."""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext

import torch

from marl_lanes.training.config import ProgramConfig


def take_resources(config: ProgramConfig) -> torch.device:
    """Give torch the configured threads and GPU; returns where the networks learn."""
    torch.set_num_threads(config.num_threads)
    device = torch.device(config.device)
    if device.index is not None:
        # A graph is captured on torch's present GPU.
        torch.cuda.set_device(device)
    return device


@contextmanager
def training_settings(device: torch.device) -> Iterator[None]:
    """Gradients, and float32 where TorchRL makes tensors of the default dtype.

    On a GPU convolutions do not round to TF32, and add up in one order.

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
            _exact_convolutions() if device.type == "cuda" else nullcontext(),
        ):
            yield
    finally:
        torch.set_default_dtype(before)


def _exact_convolutions() -> AbstractContextManager[None]:
    flags: Callable[..., AbstractContextManager[None]] = torch.backends.cudnn.flags
    return flags(enabled=True, benchmark=False, deterministic=True, allow_tf32=False)
