"""Memory format and precision of tensors between convolutions: channels last, or contiguous."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

__all__ = ["to_channels_last", "to_contiguous_float32"]

FEW_CHANNELS = 8  # up to which a plain copy of two threads is quicker than a transposed matrix


def to_channels_last(x: Float[Tensor, "n c h w"]) -> Float[Tensor, "n c h w"]:
    """The same values in channels-last order, cast to the autocast precision if autocast is on.

    For a tensor that several convolutions read: it is converted once, and concatenating it with
    their outputs does not widen it again. The output of a convolution stays the same.
    """
    device = x.device.type
    casts = torch.amp.is_autocast_available(device) and torch.is_autocast_enabled(device)
    dtype = torch.get_autocast_dtype(device) if casts else x.dtype
    return x.to(dtype, memory_format=torch.channels_last)


def to_contiguous_float32(x: Float[Tensor, "n c h w"]) -> Float[Tensor, "n c h w"]:
    """The same values, contiguous and in float32.

    For the output of convolutions before other operations: adding two tensors of different memory
    formats is slow.
    """
    is_channels_last = x.is_contiguous(memory_format=torch.channels_last)
    if len(x) > 1 or x.shape[1] <= FEW_CHANNELS or not is_channels_last:
        return x.float().contiguous()
    # torch transposes matrices in blocks, and is several times slower without, for many channels
    return x.permute(0, 2, 3, 1).flatten(0, 2).t().contiguous().view(x.shape).float()
