"""Moving what was remembered to where it is now."""

from __future__ import annotations

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
    n, _, h, w = history.shape
    if motion is None:
        return history, torch.ones(n, 1, h, w, dtype=torch.bool, device=history.device)
    x = torch.arange(w, device=motion.device, dtype=motion.dtype) + motion[:, 0]
    y = torch.arange(h, device=motion.device, dtype=motion.dtype)[:, None] + motion[:, 1]
    valid = (x >= 0) & (x <= w - 1) & (y >= 0) & (y <= h - 1)  # false for NaN
    x, y = torch.where(valid, x, 0.0), torch.where(valid, y, 0.0)
    grid = torch.stack(((2 * x + 1) / w - 1, (2 * y + 1) / h - 1), dim=-1)
    kind = torch.promote_types(history.dtype, grid.dtype)  # halves cannot tell pixels apart
    taken, grid = history.to(kind), grid.to(kind)
    moved = F.grid_sample(taken, grid, "bilinear", padding_mode="border", align_corners=False)
    return moved.to(history.dtype), valid[:, None]


def recall(
    history: Float[Tensor, "n c h w"], motion: Float[Tensor, "n 2 h w"] | None, missing: float
) -> Float[Tensor, "n c h w"]:
    """The history as seen from this frame, with the value `missing` where it is not valid."""
    moved, valid = reproject(history, motion)
    return moved.where(valid, missing)
