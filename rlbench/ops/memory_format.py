"""The order in memory, and the precision, in which convolutions compute."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor


def to_channels_last(x: Float[Tensor, "n c h w"]) -> Float[Tensor, "n c h w"]:
    """The same values, channels last; under autocast in its precision.

    For what several convolutions read: it is then converted once, and joined with what they return
    without being widened again. A convolution computes the same of it.
    """
    kind = x.device.type
    casts = torch.amp.is_autocast_available(kind) and torch.is_autocast_enabled(kind)
    dtype = torch.get_autocast_dtype(kind) if casts else x.dtype
    if len(x) > 1 or not x.is_contiguous():
        return x.to(dtype, memory_format=torch.channels_last)
    # the same as the transpose of a matrix, for which torch has a kernel twice as fast
    return x.to(dtype)[0].flatten(1).t().contiguous().view(1, *x.shape[2:], -1).permute(0, 3, 1, 2)


def to_contiguous_float32(x: Float[Tensor, "n c h w"]) -> Float[Tensor, "n c h w"]:
    """The same values, channel after channel, in float32.

    For what convolutions return and others read: a sum of two tensors in two orders is slow.
    """
    if len(x) > 1 or not x.is_contiguous(memory_format=torch.channels_last):
        return x.float().contiguous()
    return x.permute(0, 2, 3, 1).flatten(0, 2).t().contiguous().view(x.shape).float()
