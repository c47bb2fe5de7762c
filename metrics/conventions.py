"""Named conventions: how radiance becomes the values that PSNR and SSIM compare.

The same image scores differently under each, so every score names its convention, and scores of two
conventions share no column.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from metrics.display import encode_aces, encode_display, encode_hable

__all__ = ["CONVENTIONS", "SRGB", "Convention", "get_convention", "quantize"]


@dataclass(frozen=True)
class Convention:
    """How linear radiance is encoded, and what PSNR takes as its peak.

    `encode` maps any finite linear radiance, and infinity, into [0, 1]. SSIM and MS-SSIM take 1 as
    the range of values under every convention.
    """

    name: str
    sentence: str
    encode: Callable[[Tensor], Tensor]
    has_floating_peak: bool = False  # PSNR's peak is the range of the reference, with 0 in it

    def peak(self, reference: Tensor) -> Tensor:
        """The peak of PSNR for each encoded reference [n 3 h w], as [n]; at least 1e-3.

        >>> dim = torch.tensor([0.2, 0.6]).expand(1, 3, 4, 2)
        >>> CONVENTIONS["srgb"].peak(dim), CONVENTIONS["paper2023"].peak(dim)
        (tensor([1.]), tensor([0.6000]))
        """
        if not self.has_floating_peak:
            return torch.ones_like(reference[:, 0, 0, 0])
        return reference.flatten(1).amax(1).clamp_min(MIN_PEAK)  # the smallest is 0, as values >= 0


def quantize(values: Tensor, rounding: Callable[[Tensor], Tensor] = torch.round) -> Tensor:
    """Values in [0, 1] as multiples of 1/255, as a PNG stores them.

    >>> quantize(torch.tensor([0.0, 0.5, 1.0])) * 255
    tensor([  0., 128., 255.])
    """
    return rounding(values * 255) / 255


def get_convention(name: str) -> Convention:
    """The convention called `name`. Raises ValueError for an unknown one."""
    if name not in CONVENTIONS:
        raise ValueError(f"'{name}' is no convention; there are: {', '.join(CONVENTIONS)}")
    return CONVENTIONS[name]


def _encode_display_8bit(radiance: Tensor) -> Tensor:
    return quantize(encode_display(radiance))


def _encode_aces_8bit(radiance: Tensor) -> Tensor:
    return quantize(encode_aces(radiance), torch.floor)


def _clip(radiance: Tensor) -> Tensor:
    return radiance.clamp(0, 1)


MIN_PEAK = 1e-3  # of a black reference, whose PSNR has no peak

SRGB = Convention("srgb", "clipped sRGB in float, peak 1", encode_display)

# torchmetrics below 1.8 took max(target, 0) - min(target, 0) as peak where none was given
# (torchmetrics issue 3135), and Scardigli et al. 2023 gave none
PAPER_2023 = Convention(
    "paper2023",
    "clipped sRGB in 8 bits, peak is the largest value of the frame's reference",
    _encode_display_8bit,
    has_floating_peak=True,
)
# Balint et al. 2023, noisebase/data.py and test_sample_v1.py: values are cut to 8 bits, not rounded
NOISEBASE_V1 = Convention(
    "noisebase-v1",
    "ACES by Hill's fit, gamma 2.2, cut to 8 bits, peak 1; SSIM of channels, not of luminance",
    _encode_aces_8bit,
)
HABLE = Convention(
    "hable", "Hable's filmic curve as in OIDN's trainer, then sRGB, float, peak 1", encode_hable
)
LINEAR = Convention("linear", "linear radiance clipped to [0, 1], float, peak 1", _clip)
CONVENTIONS = {each.name: each for each in (SRGB, PAPER_2023, NOISEBASE_V1, HABLE, LINEAR)}
