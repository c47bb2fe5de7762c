"""Losses that denoisers are trained with, differentiable, on images in a network's range."""

from __future__ import annotations

import math

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional as F

TAPS, SIGMA = 11, 1.5  # Gaussian window of SSIM, pixels
C1, C2 = 0.01**2, 0.03**2  # (K1 L)^2 and (K2 L)^2 at a data range L of 1
WANG = (0.0448, 0.2856, 0.3001, 0.2363, 0.1333)  # scales, fine to coarse: Wang et al. 2003
EVEN = (0.2, 0.2, 0.2, 0.2, 0.2)  # the same as OIDN trains its ray-tracing filter
L1_SHARE = 0.16  # of the mixed loss: Zhao et al. 2017
SMAPE_EPS = 1e-2  # as in OIDN's training toolkit
EVENED = 0.02  # a loss of which the logarithm is as steep as itself
PERFECT = 1e-6  # a loss that is not worth making smaller


def l1(image: Float[Tensor, "n c h w"], reference: Float[Tensor, "n c h w"]) -> Float[Tensor, ""]:
    """Mean absolute difference."""
    return (image - reference).abs().mean()


def smape(
    image: Float[Tensor, "n c h w"], reference: Float[Tensor, "n c h w"]
) -> Float[Tensor, ""]:
    """Symmetric relative error, mean of |x - y| / (|x| + |y| + 0.01), in [0, 1)."""
    return ((image - reference).abs() / (image.abs() + reference.abs() + SMAPE_EPS)).mean()


def temporal_l1(
    image: Float[Tensor, "n c h w"],
    before: Float[Tensor, "n c h w"],
    reference: Float[Tensor, "n c h w"],
    reference_before: Float[Tensor, "n c h w"],
) -> Float[Tensor, ""]:
    """How far the change since the last frame is from the reference's change (L1, not warped)."""
    return l1(image - before, reference - reference_before)


def l1_ms_ssim_loss(
    image: Float[Tensor, "n c h w"],
    reference: Float[Tensor, "n c h w"],
    weights: tuple[float, ...] = WANG,
) -> Float[Tensor, ""]:
    """0.16 L1 + 0.84 (1 - MS-SSIM).

    Zhao et al. 2017, Loss Functions for Image Restoration with Neural Networks, with the L1 term
    as it is (theirs is weighted by the Gaussian of the coarsest scale), like OIDN's toolkit.
    """
    similar = ms_ssim(image, reference, weights).mean()
    return L1_SHARE * l1(image, reference) + (1 - L1_SHARE) * (1 - similar)


def log_loss(loss: Float[Tensor, ""]) -> Float[Tensor, ""]:
    """The logarithm of a loss, so that equal decibels count equally, at any budget, in any scene.

    It is as steep as the loss where that is 0.02, and flat below 1e-6.
    """
    return EVENED * loss.clamp_min(PERFECT).log()


def ms_ssim(
    image: Float[Tensor, "n c h w"],
    reference: Float[Tensor, "n c h w"],
    weights: tuple[float, ...] = WANG,
) -> Float[Tensor, " n"]:
    """Multi-scale structural similarity of images with range 1, 1 where equal; mean of channels.

    Wang, Simoncelli and Bovik 2003. Only places where the window fits are used; scales are halved
    by 2x2 means, an odd side as if zeros were beside it; a scale's mean counts as 0 where negative.
    Differs from the paper: where fewer than all scales keep both sides >= 11, those that do are
    used and their weights rescaled to sum to one. Computed in float32, also under autocast. Raises
    ValueError where not even the first scale fits.

    The two images enter as sum s and difference d, for all that SSIM needs is in the moments of
    these: its contrast-structure term is 1 - var(d) / ((var(s) + var(d)) / 2 + C2), and its
    luminance term the same of squared means. That is four maps to filter, in place of five.
    """
    shares = _shares(image.shape[-2:], weights)
    with torch.autocast(image.device.type, enabled=False):
        image, reference = image.float(), reference.float()
        pair = torch.cat((image + reference, image - reference), dim=1)  # n 2c h w
        similar = torch.ones_like(image[..., 0, 0])  # n c
        for scale, share in enumerate(shares):
            if scale > 0:
                pair = F.avg_pool2d(pair, 2, padding=(pair.shape[-2] % 2, pair.shape[-1] % 2))
            coarsest = scale == len(shares) - 1
            similar = similar * _similarity(pair, coarsest).relu().pow(share)
        return similar.mean(1)


def _shares(sides: tuple[int, ...], weights: tuple[float, ...]) -> tuple[float, ...]:
    """Exponents of the scales that fit, summing to one."""
    side, fitting = min(sides), 0
    while fitting < len(weights) and side >= TAPS:
        side, fitting = math.ceil(side / 2), fitting + 1
    if fitting == 0:
        raise ValueError(f"MS-SSIM needs sides of at least {TAPS} pixels, got {list(sides)}")
    return tuple(w / sum(weights[:fitting]) for w in weights[:fitting])


def _similarity(pair: Tensor, luminance: bool) -> Tensor:
    """SSIM of each channel [n c] from sum and difference [n 2c h w]; luminance term if asked."""
    means, squares = _blur(torch.cat((pair, pair * pair), dim=1)).chunk(2, dim=1)
    means = means * means
    sum_var, dif_var = (squares - means).chunk(2, dim=1)
    similar = 1 - dif_var / ((sum_var + dif_var) / 2 + C2)
    if luminance:
        sum_mean, dif_mean = means.chunk(2, dim=1)
        similar = similar * (1 - dif_mean / ((sum_mean + dif_mean) / 2 + C1))
    return similar.mean((-2, -1))


def _blur(maps: Tensor) -> Tensor:
    """Each map under a Gaussian window, where the window fits: two one-dimensional passes."""
    c = maps.shape[1]
    at = torch.arange(TAPS, device=maps.device, dtype=maps.dtype) - TAPS // 2
    row = torch.softmax(-at * at / (2 * SIGMA**2), dim=0).expand(c, 1, 1, TAPS)
    return F.conv2d(F.conv2d(maps, row, groups=c), row.transpose(2, 3), groups=c)
