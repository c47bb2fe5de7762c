"""Error on the display: PSNR and largest difference of clipped sRGB images."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from rlbench.ops.color import encode_srgb
from rlbench.run import FrameResult

CAP_DB = 100.0  # PSNR of equal images


def to_display(radiance: Float[Tensor, "*n 3 h w"]) -> Float[Tensor, "*n 3 h w"]:
    """Clipped sRGB in [0, 1] of linear radiance; NaN stays NaN."""
    return encode_srgb(radiance.clamp(0, 1))


def psnr(
    image: Float[Tensor, "n 3 h w"], reference: Float[Tensor, "n 3 h w"]
) -> Float[Tensor, " n"]:
    """Peak signal-to-noise ratio in dB, in [0, 100]; higher is better.

    The same figure as the benchmark's metric `psnr`: a pixel that is not finite has the largest
    error, and equal images score 100 dB.

    >>> black = torch.zeros(1, 3, 8, 8)
    >>> psnr(black + 0.214041, black)  # 0.5 in sRGB
    tensor([6.0206])
    """
    error = (to_display(image) - to_display(reference)).square()
    error = error.masked_fill(~torch.isfinite(image).all(1, keepdim=True), 1.0)
    mse = error.flatten(1).mean(1, dtype=torch.float64).clamp_min(10 ** (-CAP_DB / 10))
    return (-10 * mse.log10()).float()


def psnr_of_frames(results: Sequence[FrameResult]) -> Float[Tensor, "frames n"]:
    """PSNR of each frame of each clip of a batch, against its reference."""
    return torch.stack([psnr(result.image, result.frame.reference.mean) for result in results])


def largest_difference(images: Sequence[Tensor], others: Sequence[Tensor]) -> float:
    """The largest difference of two image sequences on the display; 1 where a value is not finite.

    >>> black = torch.zeros(1, 3, 8, 8)
    >>> round(largest_difference([black], [black + 0.214041]), 4)
    0.5
    """
    pairs = zip(images, others, strict=True)
    return max(
        float((to_display(a).double() - to_display(b).double()).abs().nan_to_num(nan=1.0).max())
        for a, b in pairs
    )
