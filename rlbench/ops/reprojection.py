"""Moving what was remembered to where it is now."""

from __future__ import annotations

from collections.abc import Callable

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn import functional as F


def reproject(
    history: Float[Tensor, "n c h w"], motion: Float[Tensor, "n 2 h w"] | None
) -> tuple[Float[Tensor, "n c h w"], Bool[Tensor, "n 1 h w"]]:
    """The history as seen from this frame, by bilinear taps, and where it is valid.

    `motion` is in pixels, from a pixel to its position in the previous frame, x right and y down;
    None means that nothing moved, and the history is returned as it is. Valid means that all taps
    with weight lie inside the image. Whether a surface was hidden is not tested here. Motion that
    is not finite is invalid.
    """
    if motion is None:
        return history, _everywhere(history)
    x, y, valid = _origin(motion)
    return _sampled(history, x, y, "bilinear"), valid


def reproject_bicubic(
    history: Float[Tensor, "n c h w"], motion: Float[Tensor, "n 2 h w"] | None
) -> tuple[Float[Tensor, "n c h w"], Bool[Tensor, "n 1 h w"]]:
    """As `reproject`, by bicubic taps: what is moved again every frame does not blur away.

    So do temporal antialiasing filters (Yang, Liu and Salvi 2020, A Survey of Temporal Antialiasing
    Techniques) with the kernel of Catmull and Rom; here it is torch's, that of Keys 1981 with an a
    of -0.75. A value stays between the least and the largest of the four bilinear taps, so that
    nothing rings beside what is bright.
    """
    if motion is None:
        return history, _everywhere(history)
    x, y, valid = _origin(motion)
    beside = F.pad(history, (0, 1, 0, 1), mode="replicate")
    taps = torch.cat((_of_four(torch.maximum, beside), _of_four(torch.minimum, beside)), 1)
    most, least = _sampled(taps, x.floor(), y.floor(), "nearest").chunk(2, dim=1)
    return _sampled(history, x, y, "bicubic").clamp(least, most), valid


def _of_four(chosen: Callable[[Tensor, Tensor], Tensor], values: Tensor) -> Tensor:
    """One of each value and its neighbours right and below; a 60th of what max_pool2d takes."""
    beside = chosen(values[..., :-1], values[..., 1:])
    return chosen(beside[..., :-1, :], beside[..., 1:, :])


def _everywhere(history: Tensor) -> Tensor:
    n, _, h, w = history.shape
    return torch.ones(n, 1, h, w, dtype=torch.bool, device=history.device)


def _origin(motion: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Where each pixel was, x and y [n h w], and whether that is inside [n 1 h w]."""
    h, w = motion.shape[-2:]
    x = torch.arange(w, device=motion.device, dtype=motion.dtype) + motion[:, 0]
    y = torch.arange(h, device=motion.device, dtype=motion.dtype)[:, None] + motion[:, 1]
    valid = (x >= 0) & (x <= w - 1) & (y >= 0) & (y <= h - 1)  # false for NaN
    return torch.where(valid, x, 0.0), torch.where(valid, y, 0.0), valid[:, None]


def _sampled(history: Tensor, x: Tensor, y: Tensor, taps: str) -> Tensor:
    h, w = history.shape[-2:]
    grid = torch.stack(((2 * x + 1) / w - 1, (2 * y + 1) / h - 1), dim=-1)
    kind = torch.promote_types(history.dtype, grid.dtype)  # halves cannot tell pixels apart
    taken, grid = history.to(kind), grid.to(kind)
    moved = F.grid_sample(taken, grid, taps, padding_mode="border", align_corners=False)
    return moved.to(history.dtype)


def reproject_or_fill(
    history: Float[Tensor, "n c h w"], motion: Float[Tensor, "n 2 h w"] | None, missing: float
) -> Float[Tensor, "n c h w"]:
    """The history as seen from this frame, with the value `missing` where it is not valid."""
    moved, valid = reproject(history, motion)
    return moved.where(valid, missing)
