"""The order in memory, and the precision, in which convolutions compute."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor


def packed(x: Float[Tensor, "n c h w"]) -> Float[Tensor, "n c h w"]:
    """The same values, channels last; under autocast in its precision.

    For what several convolutions read: it is then converted once, and joined with what they return
    without being widened again. A convolution computes the same of it.
    """
    kind = x.device.type
    casts = torch.amp.is_autocast_available(kind) and torch.is_autocast_enabled(kind)
    dtype = torch.get_autocast_dtype(kind) if casts else x.dtype
    return x.to(dtype, memory_format=torch.channels_last)
