"""Colour: the sRGB transfer curve and luminance.

Radiance is linear, with Rec. 709 primaries, which sRGB shares (IEC 61966-2-1).
"""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

__all__ = ["OIDN_LUMINANCE", "REC709_LUMINANCE", "decode_srgb", "encode_srgb", "luminance"]

REC709_LUMINANCE = (0.2126, 0.7152, 0.0722)  # ITU-R BT.709, four digits
OIDN_LUMINANCE = (0.212671, 0.715160, 0.072169)  # six digits, as in OIDN and Mitsuba
SRGB_KNEE = 0.0031308  # linear value below which the sRGB curve is a straight line


def luminance(
    radiance: Float[Tensor, "*n 3 h w"], weights: tuple[float, float, float] = OIDN_LUMINANCE
) -> Float[Tensor, "*n 1 h w"]:
    """Luminance of linear radiance: the sum of red, green and blue, weighted by `weights`.

    >>> round(luminance(torch.ones(1, 3, 1, 1)).item(), 4)
    1.0
    """
    red, green, blue = radiance.unbind(-3)
    r, g, b = weights
    return torch.add(red * r, green, alpha=g).add_(blue, alpha=b).unsqueeze(-3)


def encode_srgb(linear: Float[Tensor, "*size"]) -> Float[Tensor, "*size"]:
    """sRGB display values of linear light: 12.92 x up to 0.0031308, else 1.055 x^(1/2.4) - 0.055.

    IEC 61966-2-1; maps [0, 1] to [0, 1]. Values outside are not clipped: those below 0 continue
    the straight line, those above 1 the power curve.

    >>> round(encode_srgb(torch.tensor(0.18)).item(), 4)
    0.4614
    """
    curved = 1.055 * linear.clamp_min(SRGB_KNEE) ** (1 / 2.4) - 0.055
    return torch.where(linear > SRGB_KNEE, curved, 12.92 * linear)


def decode_srgb(display: Float[Tensor, "*size"]) -> Float[Tensor, "*size"]:
    """Linear light of sRGB display values: the inverse of `encode_srgb`, also outside [0, 1].

    >>> round(decode_srgb(torch.tensor(0.5)).item(), 4)
    0.214
    """
    curved = ((display + 0.055) / 1.055).clamp_min(0) ** 2.4
    return torch.where(display > 12.92 * SRGB_KNEE, curved, display / 12.92)
