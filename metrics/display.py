"""Display transform: linear radiance to clipped sRGB, the space in which people judge images."""

from __future__ import annotations

from jaxtyping import Float
from torch import Tensor

__all__ = ["encode_display"]

KNEE = 0.0031308  # IEC 61966-2-1: linear value below which the curve is a straight line


def encode_display(radiance: Float[Tensor, "*shape"]) -> Float[Tensor, "*shape"]:
    """Clipped sRGB in [0, 1] from linear radiance, where 1.0 is display white.

    The transfer curve of IEC 61966-2-1 (1999), without quantisation. NaN stays NaN; infinity is
    clipped to 1. `rlbench.ops.color` has the same curve; it is repeated here because metrics import
    nothing from rlbench.

    >>> import torch
    >>> display(torch.tensor([-1.0, 0.0, 0.214041, 1.0, 30.0]))
    tensor([0.0000, 0.0000, 0.5000, 1.0000, 1.0000])
    """
    linear = radiance.clamp(0, 1)
    curved = 1.055 * linear.clamp_min(KNEE) ** (1 / 2.4) - 0.055
    return curved.where(linear > KNEE, 12.92 * linear)
