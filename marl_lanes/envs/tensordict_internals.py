"""The one place of the environments that uses a name which tensordict does not promise to keep."""

from collections.abc import Mapping
from typing import Any

import torch
from tensordict import TensorDict

# To check each shape takes half as long as a road's whole step. Without the name they are checked.
_make: Any = getattr(TensorDict, "_new_unsafe", TensorDict)


def make_tensordict(
    source: Mapping[str, Any], batch_size: torch.Size, device: torch.device | None
) -> TensorDict:
    """A tensordict of tensors and tensordicts that are known to fit: shapes begin as batch_size.

    Args:
        source: by key; on ``device`` where that is not None.
        batch_size: of the tensordict.
        device: of the tensordict.
    """
    tensordict: TensorDict = _make(dict(source), batch_size, device)
    return tensordict
