"""Squared errors of encoded images, and PSNR: with and without the noise of the reference.

All images are in [0, 1], as a convention of `metrics.conventions` encodes them. `nonfinite` marks
pixels whose radiance was NaN or infinite; they have the largest error, 1 in every channel.
"""

from __future__ import annotations

import torch
from jaxtyping import Bool, Float
from torch import Tensor

__all__ = ["CAP_DB", "decibels", "mse", "psnr", "psnr_debiased"]

CAP_DB = 100.0  # PSNR of equal images; rounding to 8 bits alone gives 58.9 dB


def mse(
    image: Float[Tensor, "n 3 h w"],
    reference: Float[Tensor, "n 3 h w"],
    nonfinite: Bool[Tensor, "n 1 h w"],
) -> Float[Tensor, " n"]:
    """Mean squared error over pixels and channels, in [0, 1]; lower is better.

    >>> black, valid = torch.zeros(1, 3, 8, 8), torch.zeros(1, 1, 8, 8, dtype=torch.bool)
    >>> mse(black + 0.5, black, valid)
    tensor([0.2500])
    """
    return _mean((image - reference).square(), nonfinite).float()


def psnr(
    image: Float[Tensor, "n 3 h w"],
    reference: Float[Tensor, "n 3 h w"],
    nonfinite: Bool[Tensor, "n 1 h w"],
    peak: Float[Tensor, " n"] | float = 1.0,
) -> Float[Tensor, " n"]:
    """Peak signal-to-noise ratio in dB, at most 100; higher is better.

    10 log10(peak^2 / mse). Equal images score 100 dB. At a peak of 1 no score is below 0.

    >>> black, valid = torch.zeros(1, 3, 8, 8), torch.zeros(1, 1, 8, 8, dtype=torch.bool)
    >>> psnr(black + 0.5, black, valid), psnr(black, black, valid)
    (tensor([6.0206]), tensor([100.]))
    """
    peak = torch.as_tensor(peak, dtype=torch.float64, device=image.device)
    return decibels(_mean((image - reference).square(), nonfinite) / peak.square())


def psnr_debiased(
    image: Float[Tensor, "n 3 h w"],
    half_a: Float[Tensor, "n 3 h w"],
    half_b: Float[Tensor, "n 3 h w"],
    nonfinite: Bool[Tensor, "n 1 h w"],
) -> Float[Tensor, " n"]:
    """PSNR in dB without the noise of the reference, at most 100; higher is better.

    -10 log10(mean((x - a)(x - b))) for two independent halves a and b of the reference.
    Noise of the reference adds its variance to the squared error of `psnr`, which nears the
    clip's noise ceiling however good the image is, and shrinks the lead of a better one. Noise of
    one half is independent of the other's, so its mean drops out of the product (as in
    `mse_debiased`). An estimate of 1e-10 or less, so also one below 0, scores 100 dB: the error is
    too small for this reference to resolve.

    What remains is a bias of the display curve D: it bends, so the mean of a noisy D(a) is not
    D(truth), but differs by about D''(truth) var(a) / 2. The score is the PSNR against the mean of
    D(a), so it is trusted where that difference is small beside the image's own error.

    >>> truth, valid = torch.full((1, 3, 64, 64), 0.5), torch.zeros(1, 1, 64, 64, dtype=torch.bool)
    >>> noise = torch.randn(2, *truth.shape, generator=torch.Generator().manual_seed(0))
    >>> a, b = truth + 0.1 * noise
    >>> image = truth + 0.05  # 26.02 dB
    >>> psnr(image, (a + b) / 2, valid), psnr_debiased(image, a, b, valid)
    (tensor([21.1927]), tensor([25.9002]))
    """
    return decibels(_mean((image - half_a) * (image - half_b), nonfinite))


def decibels(error: Float[Tensor, " n"]) -> Float[Tensor, " n"]:
    """-10 log10 of a squared error whose peak is 1, at most 100.

    >>> decibels(torch.tensor([1.0, 0.001, 0.0, -1.0]))
    tensor([ -0.,  30., 100., 100.])
    """
    return (-10 * error.double().clamp_min(10 ** (-CAP_DB / 10)).log10()).float()


def _mean(error: Tensor, nonfinite: Tensor) -> Tensor:
    """The mean over channels and pixels, [n] in float64."""
    if nonfinite.any():  # a copy that most images do not need
        error = error.masked_fill(nonfinite, 1.0)
    return error.flatten(1).mean(1, dtype=torch.float64)
