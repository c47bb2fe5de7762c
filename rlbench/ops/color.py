"""Colour: the sRGB curve of the display, and luminance.

Radiance is linear with the primaries of Rec. 709, as sRGB's are (IEC 61966-2-1).
"""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

__all__ = ["OIDN_LUMINANCE", "REC709_LUMINANCE", "decode_srgb", "encode_srgb", "luminance"]

REC709_LUMINANCE = (0.2126, 0.7152, 0.0722)  # ITU-R BT.709, four digits
OIDN_LUMINANCE = (0.212671, 0.715160, 0.072169)  # the same in Open Image Denoise and Mitsuba
KNEE = 0.0031308  # linear value below which the sRGB curve is a straight line


def luminance(
    radiance: Float[Tensor, "*n 3 h w"], weights: tuple[float, float, float] = OIDN_LUMINANCE
) -> Float[Tensor, "*n 1 h w"]:
    """Luminance of linear radiance: the weighted sum of red, green and blue."""
    return (radiance * radiance.new_tensor(weights).view(3, 1, 1)).sum(-3, keepdim=True)


def encode_srgb(linear: Float[Tensor, "*size"]) -> Float[Tensor, "*size"]:
    """Display values of linear light, by the sRGB curve of IEC 61966-2-1; 1 stays 1.

    Values are not clipped. Negative light stays on the straight part of the curve.
    """
    curved = 1.055 * linear.clamp_min(KNEE) ** (1 / 2.4) - 0.055
    return torch.where(linear > KNEE, curved, 12.92 * linear)


def decode_srgb(display: Float[Tensor, "*size"]) -> Float[Tensor, "*size"]:
    """Linear light of display values: the inverse of `encode_srgb`."""
    curved = ((display + 0.055) / 1.055).clamp_min(0) ** 2.4
    return torch.where(display > 12.92 * KNEE, curved, display / 12.92)
