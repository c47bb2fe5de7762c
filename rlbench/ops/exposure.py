"""One exposure for a whole image, so that networks see every scene equally bright."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from rlbench.ops.color import luminance

KEY = 0.18  # mean grey after exposure: Reinhard et al. 2002
TILE = 16  # largest side of a tile, pixels
DARK = 1e-8  # tiles of less luminance say nothing: OIDN


def autoexposure(radiance: Float[Tensor, "n 3 h w"]) -> Float[Tensor, "n 1 1 1"]:
    """Factor that brings the log-average luminance of each image to 0.18; 1 for a black image.

    As Open Image Denoise does (Afra 2019): luminance is averaged over tiles of at most 16 x 16
    pixels, equal up to one pixel, so that noise hardly moves it; the mean is over logarithms of
    tiles brighter than 1e-8. `radiance` is linear, finite and >= 0. Autocast does not reach it: in
    half precision the exposure of a scene that brightens would move in steps.
    """
    h, w = radiance.shape[-2:]
    light = luminance(radiance)[:, 0]
    with torch.autocast(radiance.device.type, enabled=False):
        tiles = (_tiles(h, light) @ light @ _tiles(w, light).T).flatten(1)
    bright = tiles > DARK
    logs = tiles.clamp_min(DARK).log2().where(bright, 0.0)
    mean = logs.sum(1) / bright.sum(1).clamp_min(1)
    exposure = (KEY / mean.exp2()).where(bright.any(1), 1.0)
    return exposure.view(-1, 1, 1, 1)


def _tiles(side: int, like: Tensor) -> Tensor:
    """[tiles side] the matrix that averages a side over its tiles; tile i starts at i side // n."""
    count = -(-side // TILE)
    bounds = torch.arange(count + 1, device=like.device) * side // count
    pixel = torch.arange(side, device=like.device)
    inside = (pixel >= bounds[:-1, None]) & (pixel < bounds[1:, None])
    return inside.to(like.dtype) / (bounds[1:] - bounds[:-1])[:, None]
