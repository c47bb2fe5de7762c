"""Errors of linear radiance against the reference, one score per image of a batch.

All functions take linear radiance, where 1.0 is display white, as `bound_radiance` returns it: in
the range of half floats, so that its square is finite. Sums are in double precision. A pixel with a
NaN or infinite channel counts as an error, never as missing: `bound_radiance` gives it the worst
value, and `nonfinite` marks it.
"""

from __future__ import annotations

import torch
from jaxtyping import Bool, Float
from torch import Tensor

__all__ = [
    "bias",
    "bound_radiance",
    "mse_debiased",
    "nonfinite",
    "nonfinite_mask",
    "relmse",
    "relmse_trimmed",
    "smape",
]

HALF_MAX = 65504.0  # largest half float, the brightest value in a clip's EXR files
RELMSE_EPS = 1e-2  # avoids division by zero where the reference is black
MIN_REFERENCE_MEAN = 1e-4  # lower bound of the divisor of `bias`, times display white
SMAPE_EPS = 1e-2  # as in the loss of Open Image Denoise (Afra 2019, training/loss.py)
TRIMMED_SHARE = 1e-3  # of the pixels, those with the largest error


def relmse(
    image: Float[Tensor, "n 3 h w"], reference: Float[Tensor, "n 3 h w"]
) -> Float[Tensor, " n"]:
    """Relative mean squared error of linear radiance, without unit; lower is better, 0 is best.

    mean((x - r)^2 / (r^2 + 0.01)) over pixels and channels: the relative squared error of Rousselle
    et al. 2011, for each channel by itself.

    >>> reference = torch.ones(1, 3, 8, 8)
    >>> relmse(1.5 * reference, reference)  # 0.25 / 1.01
    tensor([0.2475])
    """
    error = (image - reference).square() / (reference.square() + RELMSE_EPS)
    return _mean(error)


def relmse_trimmed(
    image: Float[Tensor, "n 3 h w"],
    reference: Float[Tensor, "n 3 h w"],
    nonfinite: Bool[Tensor, "n 1 h w"],
) -> Float[Tensor, " n"]:
    """Relative squared error without the worst 0.1 % of pixels, at unit brightness; 0 is best.

    Both images are divided by the mean of the reference, so that the score is the same at every
    exposure and a dark scene weighs as much as a bright one; then the error of a pixel is that of
    `relmse`, the mean over channels, and the floor(0.001 h w) finite pixels of largest error are
    left out, since a single firefly can outweigh the rest of an image. A pixel that is not finite
    is never left out. The mean of the reference is at least 1e-4.

    >>> reference = torch.full((1, 3, 40, 50), 0.5)
    >>> image = 1.5 * reference
    >>> image[..., 3, 4] = 1e4  # a firefly, two of 2000 pixels are left out
    >>> valid = torch.zeros(1, 1, 40, 50, dtype=torch.bool)
    >>> relmse_trimmed(image, reference, valid), relmse(image, reference)  # 0.25 / 1.01
    (tensor([0.2475]), tensor([192288.7031]))
    """
    scale = _mean(reference).clamp_min(MIN_REFERENCE_MEAN).view(-1, 1, 1, 1)
    truth = reference / scale
    error = (image / scale - truth).square() / (truth.square() + RELMSE_EPS)
    by_pixel = error.mean(1).flatten(1)
    trimmed = int(TRIMMED_SHARE * by_pixel.shape[1])
    finite = by_pixel.masked_fill(nonfinite.flatten(1), -1.0) if nonfinite.any() else by_pixel
    worst = finite.topk(trimmed, 1).indices
    kept = by_pixel.scatter(1, worst, 0.0).sum(1, dtype=torch.float64)
    return (kept / (by_pixel.shape[1] - trimmed)).float()


def smape(
    image: Float[Tensor, "n 3 h w"],
    reference: Float[Tensor, "n 3 h w"],
    nonfinite: Bool[Tensor, "n 1 h w"],
) -> Float[Tensor, " n"]:
    """Symmetric mean absolute percentage error of linear radiance, in [0, 1]; 0 is best.

    mean(|x - r| / (|x| + |r| + 0.01)) over pixels and channels (Vogels et al. 2018, section 4),
    with the constant of Open Image Denoise's loss. A pixel that is not finite has error 1.

    >>> reference, valid = torch.ones(1, 3, 8, 8), torch.zeros(1, 1, 8, 8, dtype=torch.bool)
    >>> smape(1.5 * reference, reference, valid)  # 0.5 / 2.51
    tensor([0.1992])
    """
    error = (image - reference).abs() / (image.abs() + reference.abs() + SMAPE_EPS)
    return _mean(error.masked_fill(nonfinite, 1.0) if nonfinite.any() else error)


def mse_debiased(
    image: Float[Tensor, "n 3 h w"],
    half_a: Float[Tensor, "n 3 h w"],
    half_b: Float[Tensor, "n 3 h w"],
) -> Float[Tensor, " n"]:
    """Mean squared error of linear radiance without the reference's noise; lower is better.

    mean((x - a)(x - b)) over pixels and channels, for two independent halves a and b of the
    reference: an unbiased estimate of the squared error against the converged image. It may fall
    below zero where the error is smaller than the reference's noise. Not clipped to the display,
    because clipping would bias it.

    >>> truth, noise = torch.ones(1, 3, 64, 64), torch.randn(2, 1, 3, 64, 64)
    >>> score = mse_debiased(truth + 0.1, truth + noise[0], truth + noise[1])  # error 0.01
    >>> abs(score.item() - 0.01) < 0.1  # the plain error would be 0.51 larger
    True
    """
    return _mean((image - half_a) * (image - half_b))


def bias(
    image: Float[Tensor, "n 3 h w"], reference: Float[Tensor, "n 3 h w"]
) -> Float[Tensor, " n"]:
    """Excess of the image's mean radiance in percent of the reference's; 0 is best.

    100 (mean(x) - mean(r)) / mean(r) of linear radiance over pixels and channels; positive if too
    bright, negative if too dark. Noise averages out. What remains is energy that a method adds or
    loses, for example by averaging the samples that also decided where to sample. mean(r) is at
    least 1e-4.

    >>> reference = torch.ones(1, 3, 8, 8)
    >>> bias(0.75 * reference, reference)
    tensor([-25.])
    """
    reference_mean = _mean(reference)
    return 100 * _mean(image - reference) / reference_mean.clamp_min(MIN_REFERENCE_MEAN)


def nonfinite(image: Float[Tensor, "n 3 h w"]) -> Float[Tensor, " n"]:
    """Number of pixels with a NaN or infinite channel; lower is better, 0 is best.

    >>> nonfinite(torch.tensor([0.5, torch.nan]).expand(1, 3, 1, 2))
    tensor([1.])
    """
    return nonfinite_mask(image).flatten(1).sum(1).float()


def nonfinite_mask(image: Float[Tensor, "n 3 h w"]) -> Bool[Tensor, "n 1 h w"]:
    """True where a channel of the pixel is NaN or infinite.

    >>> nonfinite_mask(torch.tensor([0.5, -torch.inf]).expand(1, 3, 1, 2)).flatten().tolist()
    [False, True]
    """
    return (image * 0).sum(1, keepdim=True).isnan()  # one pass, as 0 inf is NaN


def bound_radiance(
    radiance: Float[Tensor, "n 3 h w"], nonfinite: Bool[Tensor, "n 1 h w"] | None = None
) -> Float[Tensor, "n 3 h w"]:
    """Radiance clamped to the range of half floats.

    Pixels that `nonfinite` marks are -65504, as far from any reference as a value can be.

    >>> bound_radiance(torch.tensor([0.5, 1e9]).expand(1, 3, 1, 2))[0, 0, 0].tolist()
    [0.5, 65504.0]
    """
    clamped = radiance.clamp(-HALF_MAX, HALF_MAX)
    return clamped if nonfinite is None else clamped.masked_fill(nonfinite, -HALF_MAX)


def _mean(values: Float[Tensor, "n c h w"]) -> Float[Tensor, " n"]:
    """The mean over pixels and channels, summed in double precision."""
    return values.flatten(1).mean(1, dtype=torch.float64).float()
