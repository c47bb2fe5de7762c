"""Training losses: L1, SMAPE, temporal L1, and L1 mixed with MS-SSIM."""

from __future__ import annotations

import math

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional as F

from rlbench.ops.color import encode_srgb
from rlbench.ops.transfer import LOG_SCALE, log_forward

__all__ = [
    "UNIFORM_WEIGHTS",
    "MS_SSIM_WEIGHTS",
    "display_mse",
    "l1",
    "l1_ms_ssim_loss",
    "log_loss",
    "log_transfer_loss",
    "ms_ssim",
    "smape",
    "temporal_l1",
]

WINDOW_SIZE, SIGMA = 11, 1.5  # Gaussian window of SSIM, pixels
C1, C2 = 0.01**2, 0.03**2  # (K1 L)^2 and (K2 L)^2 at a data range L of 1
MS_SSIM_WEIGHTS = (0.0448, 0.2856, 0.3001, 0.2363, 0.1333)  # Wang et al. 2003, fine to coarse
UNIFORM_WEIGHTS = (0.2, 0.2, 0.2, 0.2, 0.2)  # as OIDN trains its ray-tracing filter
L1_WEIGHT = 0.16  # in l1_ms_ssim_loss: Zhao et al. 2017
SMAPE_EPS = 1e-2  # as in OIDN's training toolkit
LOG_LOSS_SCALE = 0.02  # the loss at which log_loss has slope 1
MIN_LOSS = 1e-6  # below this, log_loss is constant
MIN_RADIANCE = -0.999 / LOG_SCALE  # in log transfer: its logarithm is finite down to -1/64


def l1(image: Float[Tensor, "n c h w"], reference: Float[Tensor, "n c h w"]) -> Float[Tensor, ""]:
    """Mean absolute error, mean |x - y|."""
    return (image - reference).abs().mean()


def smape(
    image: Float[Tensor, "n c h w"], reference: Float[Tensor, "n c h w"], eps: float = SMAPE_EPS
) -> Float[Tensor, ""]:
    """Symmetric mean absolute percentage error: mean of |x - y| / (|x| + |y| + eps), in [0, 1).

    An `eps` of 0.01 as in OIDN's training toolkit.
    """
    return ((image - reference).abs() / (image.abs() + reference.abs() + eps)).mean()


def temporal_l1(
    image: Float[Tensor, "n c h w"],
    previous: Float[Tensor, "n c h w"],
    reference: Float[Tensor, "n c h w"],
    previous_reference: Float[Tensor, "n c h w"],
) -> Float[Tensor, ""]:
    """L1 error of the change from the previous frame, mean |(x - x') - (y - y')|, not warped."""
    return l1(image - previous, reference - previous_reference)


def display_mse(
    image: Float[Tensor, "n c h w"], reference: Float[Tensor, "n c h w"]
) -> Float[Tensor, ""]:
    """Mean squared error of sRGB display values, whose logarithm PSNR is.

    Both are linear radiance. Where the reference is display white or more, an image above white has
    no error. An image below 0 has one, and a gradient, although a display shows it as black.
    """
    white = reference >= 1
    image = torch.where(white, image.clamp_max(1), image)
    return (encode_srgb(image) - encode_srgb(reference.clamp(0, 1))).square().mean()


def l1_ms_ssim_loss(
    image: Float[Tensor, "n c h w"],
    reference: Float[Tensor, "n c h w"],
    weights: tuple[float, ...] = MS_SSIM_WEIGHTS,
) -> Float[Tensor, ""]:
    """0.16 L1 + 0.84 (1 - MS-SSIM), for images in [0, 1], such as after a transfer function.

    Zhao et al. 2017, Loss Functions for Image Restoration with Neural Networks. Differs from the
    paper, as OIDN's toolkit does: the L1 term is not weighted by the coarsest scale's Gaussian.
    """
    similarity = ms_ssim(image, reference, weights).mean()
    return L1_WEIGHT * l1(image, reference) + (1 - L1_WEIGHT) * (1 - similarity)


def log_transfer_loss(
    image: Float[Tensor, "n c h w"], reference: Float[Tensor, "n c h w"]
) -> Float[Tensor, ""]:
    """`l1_ms_ssim_loss` of linear radiance in log transfer.

    A network that writes far below zero in log transfer has radiance -1/64, whose logarithm is not
    finite; radiance counts as little more than that at least.
    """
    return l1_ms_ssim_loss(log_forward(image.clamp_min(MIN_RADIANCE)), log_forward(reference))


def log_loss(loss: Float[Tensor, ""]) -> Float[Tensor, ""]:
    """0.02 log(loss): equal relative improvements count equally at any budget and in any scene.

    The slope is 1 at a loss of 0.02, and 0 below 1e-6.
    """
    return LOG_LOSS_SCALE * loss.clamp_min(MIN_LOSS).log()


def ms_ssim(
    image: Float[Tensor, "n c h w"],
    reference: Float[Tensor, "n c h w"],
    weights: tuple[float, ...] = MS_SSIM_WEIGHTS,
) -> Float[Tensor, " n"]:
    """Multi-scale structural similarity of images in [0, 1]: mean of channels, 1 for equal images.

    Wang, Simoncelli and Bovik 2003, with a Gaussian window of 11 x 11 pixels and sigma 1.5. Only
    positions where the window fits are used. Each scale halves the image by 2 x 2 means, with odd
    sides padded by zeros; a negative mean of a scale counts as 0. Differs from the paper: if not
    all scales have both sides >= 11, only those that do are used, with weights rescaled to sum to
    one. Computed in float32, also under autocast. Raises ValueError if not even the first scale
    fits.

    SSIM is computed from the moments of the sum s and the difference d of both images: its
    contrast-structure term is 1 - var(d) / ((var(s) + var(d)) / 2 + C2), and its luminance term is
    the same expression of squared means with C1. This filters four maps instead of five.

    >>> image = torch.rand(2, 3, 32, 32)
    >>> [round(value, 4) for value in ms_ssim(image, image).tolist()]
    [1.0, 1.0]
    """
    exponents = _scale_exponents(image.shape[-2:], weights)
    with torch.autocast(image.device.type, enabled=False):
        image, reference = image.float(), reference.float()
        pair = torch.cat((image + reference, image - reference), dim=1)  # n 2c h w
        similarity = torch.ones_like(image[..., 0, 0])  # n c
        for scale, exponent in enumerate(exponents):
            if scale > 0:
                pair = F.avg_pool2d(pair, 2, padding=(pair.shape[-2] % 2, pair.shape[-1] % 2))
            coarsest = scale == len(exponents) - 1
            similarity = similarity * _ssim(pair, luminance=coarsest).relu().pow(exponent)
        return similarity.mean(1)


def _scale_exponents(sides: tuple[int, ...], weights: tuple[float, ...]) -> tuple[float, ...]:
    """Exponents of the scales at which the window fits; they sum to one."""
    side, scales = min(sides), 0
    while scales < len(weights) and side >= WINDOW_SIZE:
        side, scales = math.ceil(side / 2), scales + 1
    if scales == 0:
        raise ValueError(f"MS-SSIM needs sides of at least {WINDOW_SIZE} pixels, got {list(sides)}")
    return tuple(w / sum(weights[:scales]) for w in weights[:scales])


def _ssim(pair: Tensor, luminance: bool) -> Tensor:
    """SSIM [n c] from sum and difference [n 2c h w], with or without the luminance term."""
    means, squares = _blur(torch.cat((pair, pair * pair), dim=1)).chunk(2, dim=1)
    means = means * means
    sum_var, diff_var = (squares - means).chunk(2, dim=1)
    similarity = 1 - diff_var / ((sum_var + diff_var) / 2 + C2)
    if luminance:
        sum_mean, diff_mean = means.chunk(2, dim=1)
        similarity = similarity * (1 - diff_mean / ((sum_mean + diff_mean) / 2 + C1))
    return similarity.mean((-2, -1))


def _blur(maps: Tensor) -> Tensor:
    """Each map filtered by the Gaussian window, where it fits: two one-dimensional passes."""
    c = maps.shape[1]
    offsets = torch.arange(WINDOW_SIZE, device=maps.device, dtype=maps.dtype) - WINDOW_SIZE // 2
    row = torch.softmax(-offsets * offsets / (2 * SIGMA**2), dim=0).expand(c, 1, 1, WINDOW_SIZE)
    return F.conv2d(F.conv2d(maps, row, groups=c), row.transpose(2, 3), groups=c)
