"""Autoexposure: one factor per image, so that networks see all scenes at the same brightness."""

from __future__ import annotations

from functools import lru_cache

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from rlbench.ops.asking import is_recorded
from rlbench.ops.color import luminance

__all__ = ["autoexposure", "log_average"]

MIDDLE_GREY = 0.18  # log-average luminance after exposure (the "key" of Reinhard et al. 2002)
MAX_TILE_SIDE = 16  # pixels
MIN_LUMINANCE = 1e-8  # darker tiles are ignored, as in OIDN
MIN_SHARE = 1e-6  # of known pixels in a tile, below that of a single one


def autoexposure(radiance: Float[Tensor, "n 3 h w"]) -> Float[Tensor, "n 1 1 1"]:
    """Factor that brings the log-average luminance of each image to 0.18; 1 for a black image.

    0.18 / 2^mean(log2 L_t), where L_t is the mean luminance of tile t, over tiles brighter than
    1e-8. Follows Open Image Denoise (Afra 2019): tiles have at most 16 x 16 pixels and differ in
    size by at most one pixel; averaging over tiles makes the factor robust to noise. `radiance` is
    linear, finite and >= 0. Computed outside autocast: in half precision the exposure of a scene
    that gets brighter would change in steps.

    >>> autoexposure(torch.full((1, 3, 8, 8), 0.36)).item()
    0.5
    """
    return MIDDLE_GREY / log_average(luminance(radiance))


def log_average(
    light: Float[Tensor, "n 1 h w"], known: Bool[Tensor, "n 1 h w"] | None = None
) -> Float[Tensor, "n 1 1 1"]:
    """The log-average of each image's luminance over tiles, as in `autoexposure`; 0.18 for black.

    Tiles are means of the `known` pixels, where that is given; others must be 0.
    """
    h, w = light.shape[-2:]
    light = light[:, 0]
    with torch.autocast(light.device.type, enabled=False):
        make = _tile_averaging if is_recorded(light) else _kept_averaging
        rows = make(h, light.device, light.dtype)
        columns = make(w, light.device, light.dtype).T
        tiles = (rows @ light @ columns).flatten(1)
        if known is not None:
            shares = (rows @ known[:, 0].to(light.dtype) @ columns).flatten(1)
            tiles = tiles / shares.clamp_min(MIN_SHARE)
    bright = tiles > MIN_LUMINANCE
    logs = tiles.clamp_min(MIN_LUMINANCE).log2().where(bright, 0.0)
    mean = logs.sum(1) / bright.sum(1).clamp_min(1)
    average = mean.exp2().where(bright.any(1), MIDDLE_GREY)
    return average.view(-1, 1, 1, 1)


def _tile_averaging(side: int, device: torch.device, dtype: torch.dtype) -> Tensor:
    """Matrix [tiles side] that averages a side over its tiles; tile i starts at i * side // n."""
    count = -(-side // MAX_TILE_SIDE)
    bounds = torch.arange(count + 1, device=device) * side // count
    pixel = torch.arange(side, device=device)
    inside = (pixel >= bounds[:-1, None]) & (pixel < bounds[1:, None])
    return inside.to(dtype) / (bounds[1:] - bounds[:-1])[:, None]


# made outside inference mode, so that it can be used in both modes
_kept_averaging = lru_cache(maxsize=32)(torch.inference_mode(False)(_tile_averaging))
