"""What a display would show: linear radiance becomes clipped sRGB, on which people judge images."""

from __future__ import annotations

from jaxtyping import Float
from torch import Tensor

KNEE = 0.0031308  # IEC 61966-2-1: the curve is straight below this linear value


def display(radiance: Float[Tensor, "*shape"]) -> Float[Tensor, "*shape"]:
    """sRGB in [0, 1] of linear radiance, where 1.0 is display white and all above it is clipped.

    The transfer curve of IEC 61966-2-1 (1999), not quantised. NaN stays NaN; infinity is clipped.
    """
    linear = radiance.clamp(0, 1)
    curved = 1.055 * linear.clamp_min(KNEE) ** (1 / 2.4) - 0.055
    return curved.where(linear > KNEE, 12.92 * linear)
