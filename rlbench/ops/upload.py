"""Numbers of the host on a device, without a wait for what that computes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

__all__ = ["upload"]


def upload(numbers: Sequence[Any] | Tensor, device: torch.device) -> Tensor:
    """A tensor of (nested) numbers on the device; a tensor that is there already stays the same.

    A copy from common memory to a GPU waits until the GPU has done all that was queued before; one
    from pinned memory is queued behind it.

    >>> upload([[1, 2], [3, 4]], torch.device("cpu")).tolist()
    [[1, 2], [3, 4]]
    """
    if device.type != "cuda":
        return torch.as_tensor(numbers, device=device)
    values = torch.as_tensor(numbers)
    return values if values.is_cuda else values.pin_memory().to(device, non_blocking=True)
