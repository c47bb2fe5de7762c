"""Error and quality measures of one image against its reference, one score per image of a batch.

All functions take linear radiance, where 1.0 is display white. A pixel with a NaN or infinite
channel counts as an error, never as missing.
"""

from __future__ import annotations

import math

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor

from metrics.display import encode_display

__all__ = [
    "bias",
    "max_scales",
    "ms_ssim",
    "mse_debiased",
    "nonfinite",
    "nonfinite_mask",
    "psnr",
    "relmse",
]

CAP_DB = 100.0  # PSNR of equal images; rounding to 8 bits alone gives 58.9 dB
HALF_MAX = 65504.0  # largest half float, the brightest value in a clip's EXR files
RELMSE_EPS = 1e-2  # avoids division by zero where the reference is black
SCALE_WEIGHTS = (0.0448, 0.2856, 0.3001, 0.2363, 0.1333)  # Wang et al. 2003, from fine to coarse
WINDOW = 11  # taps of the Gaussian, sigma 1.5
MIN_REFERENCE_MEAN = 1e-4  # lower bound of the divisor of `bias`, times display white
K1_WITHOUT_LUMINANCE = 1e6  # as K1 of SSIM it makes the luminance term 1 and leaves contrast


def psnr(
    image: Float[Tensor, "n 3 h w"], reference: Float[Tensor, "n 3 h w"]
) -> Float[Tensor, " n"]:
    """Peak signal-to-noise ratio in dB, in [0, 100]; higher is better.

    -10 log10(MSE), the mean squared error of clipped sRGB (`display`) over pixels and channels, so
    the peak is 1. A pixel that is not finite has the largest error, 1 in every channel. Equal
    images score 100 dB.

    >>> black = torch.zeros(1, 3, 8, 8)
    >>> psnr(black + 0.214041, black), psnr(black, black)  # 0.5 in sRGB
    (tensor([6.0206]), tensor([100.]))
    """
    error = (encode_display(image) - encode_display(reference)).square()
    error = error.masked_fill(nonfinite_mask(image), 1.0)
    mse = error.flatten(1).mean(1, dtype=torch.float64).clamp_min(10 ** (-CAP_DB / 10))
    return (-10 * mse.log10()).float()


def ms_ssim(
    image: Float[Tensor, "n 3 h w"], reference: Float[Tensor, "n 3 h w"], scales: int = 5
) -> Float[Tensor, " n"]:
    """Multi-scale structural similarity of clipped sRGB, in [0, 1]; higher is better.

    Wang, Simoncelli, Bovik 2003, Multiscale Structural Similarity for Image Quality Assessment:
    the product over scales of contrast and structure terms, and the luminance term at the coarsest
    scale, with the exponents SCALE_WEIGHTS. Computed by pytorch-msssim with an 11 x 11 Gaussian
    window of sigma 1.5 and range 1. There negative contrast counts as 0, so that no power of it is
    NaN, and odd sides are padded with zeros before they are halved.

    With fewer than 5 `scales` the coarsest are left out, and the other weights are scaled to the
    sum of all; that is a different metric and needs a different name. A pixel that is not finite is
    replaced by black or white, whichever is further from the reference. Raises ValueError if a side
    is too small for `scales`.

    >>> image = torch.rand(1, 3, 64, 96)
    >>> [round(score, 4) for score in ms_ssim(image, image, max_scales(64, 96)).tolist()]
    [1.0]
    """
    h, w = image.shape[-2:]
    if scales > max_scales(h, w):
        raise ValueError(
            f"MS-SSIM with {scales} scales needs sides above {(WINDOW - 1) << (scales - 1)} "
            f"pixels, found {h} x {w}, which allow {max_scales(h, w)}. Use "
            "MS_SSIM.at(height, width) of metrics.catalog"
        )
    reference_srgb = encode_display(reference)
    furthest = (reference_srgb < 0.5).to(reference_srgb.dtype)
    image_srgb = torch.where(nonfinite_mask(image), furthest, encode_display(image))
    if scales == len(SCALE_WEIGHTS):
        return _five_scales(image_srgb, reference_srgb)
    return _fewer_scales(image_srgb, reference_srgb, scales)


def max_scales(height: int, width: int) -> int:
    """Largest number of scales of MS-SSIM, 0 to 5, whose coarsest image holds a whole window.

    >>> max_scales(1080, 1920), max_scales(96, 128), max_scales(10, 10)
    (5, 4, 0)
    """
    halvings = (min(height, width) - 1) // (WINDOW - 1)
    return min(halvings.bit_length(), len(SCALE_WEIGHTS))


def relmse(
    image: Float[Tensor, "n 3 h w"], reference: Float[Tensor, "n 3 h w"]
) -> Float[Tensor, " n"]:
    """Relative mean squared error of linear radiance, without unit; lower is better, 0 is best.

    mean((x - r)^2 / (r^2 + 0.01)) over pixels and channels: the relative squared error of Rousselle
    et al. 2011, for each channel by itself. Values are clamped to the range of half floats, and a
    pixel that is not finite takes the worst of these.

    >>> reference = torch.ones(1, 3, 8, 8)
    >>> relmse(1.5 * reference, reference)  # 0.25 / 1.01
    tensor([0.2475])
    """
    truth = _clamp_to_half(reference)
    error = (_clamp_to_half(image) - truth).square() / (truth.square() + RELMSE_EPS)
    return error.flatten(1).mean(1).float()


def mse_debiased(
    image: Float[Tensor, "n 3 h w"],
    half_a: Float[Tensor, "n 3 h w"],
    half_b: Float[Tensor, "n 3 h w"],
) -> Float[Tensor, " n"]:
    """Mean squared error of linear radiance without the reference's noise; lower is better.

    mean((x - a)(x - b)) over pixels and channels, for two independent halves a and b of the
    reference: an unbiased estimate of the squared error against the converged image. It may fall
    below zero where the error is smaller than the reference's noise. Not clipped to the display,
    because clipping would bias it. Values beyond half floats and pixels that are not finite are
    treated as in `relmse`.

    >>> truth, noise = torch.ones(1, 3, 64, 64), torch.randn(2, 1, 3, 64, 64)
    >>> score = mse_debiased(truth + 0.1, truth + noise[0], truth + noise[1])  # error 0.01
    >>> abs(score.item() - 0.01) < 0.1  # the plain error would be 0.51 larger
    True
    """
    clamped = _clamp_to_half(image)
    error = (clamped - _clamp_to_half(half_a)) * (clamped - _clamp_to_half(half_b))
    return error.flatten(1).mean(1).float()


def bias(
    image: Float[Tensor, "n 3 h w"], reference: Float[Tensor, "n 3 h w"]
) -> Float[Tensor, " n"]:
    """Excess of the image's mean radiance in percent of the reference's; 0 is best.

    100 (mean(x) - mean(r)) / mean(r) of linear radiance over pixels and channels; positive if too
    bright, negative if too dark. Noise averages out. What remains is energy that a method adds or
    loses, for example by averaging the samples that also decided where to sample. Values beyond
    half floats and pixels that are not finite are treated as in `relmse`; mean(r) is at least 1e-4.

    >>> reference = torch.ones(1, 3, 8, 8)
    >>> bias(0.75 * reference, reference)
    tensor([-25.])
    """
    reference_mean = _clamp_to_half(reference).flatten(1).mean(1)
    excess = _clamp_to_half(image).flatten(1).mean(1) - reference_mean
    return (100 * excess / reference_mean.clamp_min(MIN_REFERENCE_MEAN)).float()


def nonfinite(image: Float[Tensor, "n 3 h w"]) -> Float[Tensor, " n"]:
    """Number of pixels with a NaN or infinite channel; lower is better, 0 is best.

    >>> nonfinite(torch.tensor([0.5, torch.nan]).expand(1, 3, 1, 2))
    tensor([1.])
    """
    return nonfinite_mask(image).flatten(1).sum(1).float()


def nonfinite_mask(image: Float[Tensor, "n 3 h w"]) -> Bool[Tensor, "n 1 h w"]:
    """True where a channel of the pixel is NaN or infinite."""
    return ~torch.isfinite(image).all(1, keepdim=True)


def _clamp_to_half(image: Tensor) -> Tensor:
    """The image clamped to the range of half floats, in float64 so that its square is finite."""
    clamped = image.double().clamp(-HALF_MAX, HALF_MAX)
    return clamped.masked_fill(nonfinite_mask(image), -HALF_MAX)


def _five_scales(image: Tensor, reference: Tensor) -> Tensor:
    from pytorch_msssim import ms_ssim as library_ms_ssim

    score: Tensor = library_ms_ssim(image, reference, data_range=1.0, size_average=False)
    return score


def _fewer_scales(image: Tensor, reference: Tensor, scales: int) -> Tensor:
    """pytorch-msssim's SSIM at each scale, because its MS-SSIM rejects fewer than five scales."""
    from pytorch_msssim import ssim

    n = image.shape[0]
    x, y = image.flatten(0, 1).unsqueeze(1), reference.flatten(0, 1).unsqueeze(1)  # n*3 1 h w
    normalisation = math.fsum(SCALE_WEIGHTS) / math.fsum(SCALE_WEIGHTS[:scales])
    score = torch.ones_like(x[:, 0, 0, 0])
    for scale, weight in enumerate(SCALE_WEIGHTS[:scales]):
        k1 = 0.01 if scale == scales - 1 else K1_WITHOUT_LUMINANCE  # luminance: coarsest scale only
        term = ssim(x, y, data_range=1.0, size_average=False, K=(k1, 0.03))
        score = score * term.clamp_min(0) ** (weight * normalisation)
        odd = [side % 2 for side in x.shape[2:]]
        x, y = F.avg_pool2d(x, 2, padding=odd), F.avg_pool2d(y, 2, padding=odd)
    return score.view(n, 3).mean(1)
