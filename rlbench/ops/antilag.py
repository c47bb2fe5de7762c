"""Antilag: reduce the weight of the history where new samples contradict it."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional as F

from rlbench.ops.accumulation import AccumulatedRadiance
from rlbench.ops.box_filter import block_mean, box_mean
from rlbench.ops.color import luminance
from rlbench.ops.padding import crop
from rlbench.ops.transfer import log_inverse

__all__ = ["history_confidence", "relative_change"]

CELL = 4  # pixels, side of the cells that windows are summed from
WINDOWS = (3, 5, 13)  # cells, sides of windows: small changes, and dim ones that need many pixels
NOISE_ERRORS = 2.0  # standard errors of a change that count as noise
REJECTION_SLOPE = 3.0  # a certain relative change of 1/3 rejects the whole history
MIN_PIXELS = 3.0  # a window with fewer sampled pixels says nothing
DARK_RADIANCE = 0.1  # added to a pixel's radiance before its weight in the window is taken


@torch.no_grad()
def history_confidence(
    old: AccumulatedRadiance, new: AccumulatedRadiance, image: Float[Tensor, "n 3 h w"]
) -> Float[Tensor, "n 1 h w"]:
    """History confidence in [0, 1] from a windowed temporal gradient; 1 keeps the history.

    After Schied, Peters and Dachsbacher 2018, Gradient Estimation for Real-Time Adaptive Temporal
    Filtering, who reject history by |change| over the larger of both values. Differs from the
    paper: they compare samples of the same random numbers. Here random numbers differ, so the
    change is the mean over a window, of pixels sampled in both, less what may be chance. Its
    standard error is the observed one or, if larger, the one that the variance of the old radiance
    predicts: where few samples are bright, a window without any looks as if it had gone dark.

    Pixels are weighted by the inverse of the previous `image` (log transfer); otherwise a lamp that
    stays on hides what goes dark around it. They are not weighted by the old radiance: a pixel that
    is dark there by chance gets brighter.
    """
    h, w = new.accumulated_spp.shape[-2:]
    change = F.interpolate(
        relative_change(old, new, image), scale_factor=float(CELL), mode="bilinear"
    )
    return (1 - REJECTION_SLOPE * crop(change, h, w)).clamp(0, 1)


def relative_change(
    old: AccumulatedRadiance, new: AccumulatedRadiance, image: Float[Tensor, "n 3 h w"]
) -> Float[Tensor, "n 1 h2 w2"]:
    """Relative change of radiance beyond chance, one value a cell: the largest over all windows."""
    h, w = new.accumulated_spp.shape[-2:]
    both = ((new.accumulated_spp > 0) & (old.accumulated_spp > 0)).to(new.mean.dtype)
    scale = both / (luminance(log_inverse(image)).clamp_min(0) + DARK_RADIANCE)
    then, now = luminance(old.mean) * scale, luminance(new.mean) * scale
    change, variance = now - then, old.variance * scale.square()
    predicted = variance * (
        1 / new.accumulated_spp.clamp_min(1) + 1 / old.accumulated_spp.clamp_min(1)
    )
    terms = torch.cat((both, change, change.square(), predicted, then, now), 1)
    cells = block_mean(F.pad(terms, (0, -w % CELL, 0, -h % CELL)), CELL)
    return torch.stack([_window_change(cells, side) for side in WINDOWS]).amax(0)


def _window_change(cells: Float[Tensor, "n 6 h w"], side: int) -> Float[Tensor, "n 1 h w"]:
    """The change of each window beyond chance, over the larger of its values before and now."""
    share, *sums = box_mean(cells, side, "constant").chunk(6, 1)
    change, square, predicted, then, now = (total / share.clamp_min(1e-6) for total in sums)
    pixels = share * (side * CELL) ** 2
    variance = torch.maximum((square - change.square()).clamp_min(0), predicted)
    error = (variance / pixels.clamp_min(1)).sqrt()
    certain = (change.abs() - NOISE_ERRORS * error).clamp_min(0)
    relative = certain / torch.maximum(then, now).clamp_min(1e-4)
    return relative.where(pixels > MIN_PIXELS, 0.0)
