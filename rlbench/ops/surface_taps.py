"""Bilinear taps of the last frame that lie on the surface of a pixel: depth and normal agree."""

from __future__ import annotations

from typing import NamedTuple

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

__all__ = ["SurfaceTaps", "find_surface_taps"]

MAX_DEPTH_DIFFERENCE = 0.1  # relative, between two views of one surface (RTXDI, Q2RTX)
MIN_WEIGHT = 0.01  # total weight below which no tap counts (Falcor's SVGF pass)


class SurfaceTaps(NamedTuple):
    """For each pixel the pixels of the last frame around its previous position."""

    pixels: Int[Tensor, "n 4 h w"] | None  # in reading order, 0 outside; None: the pixel itself
    weight: Float[Tensor, "n taps h w"]  # sums to 1, or to 0 where no tap is on the surface

    @property
    def valid(self) -> Bool[Tensor, "n 1 h w"]:
        """True where a tap counts."""
        return self.weight.sum(1, keepdim=True) > 0

    def gather(self, history: Float[Tensor, "n c h w"]) -> Float[Tensor, "n c h w"]:
        """The history as seen from this frame: the weighted mean of the taps, or 0 without any."""
        if self.pixels is None:
            return history * self.weight
        total = torch.zeros_like(history)
        for pixel, weight in zip(self.pixels.unbind(1), self.weight.unbind(1), strict=True):
            total = torch.addcmul(total, _read(history, pixel), weight[:, None])
        return total


def find_surface_taps(
    motion: Float[Tensor, "n 2 h w"] | None,
    now: tuple[Float[Tensor, "n 1 h w"], Float[Tensor, "n 3 h w"]],
    before: tuple[Float[Tensor, "n 1 h w"], Float[Tensor, "n 3 h w"]],
    min_normal_cosine: float,
) -> SurfaceTaps:
    """The taps on the surface of each pixel, as in SVGF (Schied et al. 2017) before its 3 x 3 box.

    `now` and `before` are depth and unit normals of both frames, 0 where there is no surface. A tap
    counts if depths differ by at most 10 % and normals have at least this cosine. `motion` is in
    pixels to the last frame; None means that nothing moves. Motion that is not finite, and taps
    outside the image, give no history. Nothing here depends on values by branching.

    >>> wall = torch.ones(1, 1, 1, 3), torch.ones(1, 3, 1, 3) / 3**0.5
    >>> motion = torch.tensor([0.5, 0.0]).view(1, 2, 1, 1).expand(1, 2, 1, 3)
    >>> taps = find_surface_taps(motion, wall, wall, min_normal_cosine=0.9)
    >>> taps.gather(torch.tensor([0.0, 1.0, 2.0]).view(1, 1, 1, 3)).flatten().tolist()
    [0.5, 1.5, 2.0]
    """
    (depth, normal), (old_depth, old_normal) = now, before
    h, w = depth.shape[2:]
    old = torch.cat((old_depth, old_normal), 1)
    if motion is None:
        is_same = _is_same_surface(old, depth, normal, min_normal_cosine)
        return SurfaceTaps(None, is_same.to(depth.dtype))
    x, y = (_previous_position(motion, depth, axis) for axis in (0, 1))
    left, top = x.floor(), y.floor()
    right_share, down_share = x - left, y - top
    pixels, weights = [], []
    for down in (0, 1):
        for right in (0, 1):
            column, row = left + right, top + down
            inside = (column >= 0) & (column < w) & (row >= 0) & (row < h)
            pixel = (row.clamp(0, h - 1) * w + column.clamp(0, w - 1)).long()
            is_same = _is_same_surface(_read(old, pixel), depth, normal, min_normal_cosine)
            bilinear = (right_share if right else 1 - right_share) * (
                down_share if down else 1 - down_share
            )
            pixels.append(pixel)
            weights.append(torch.where(inside & is_same[:, 0], bilinear, 0.0))
    weight = torch.stack(weights, 1)
    total = weight.sum(1, keepdim=True)
    weight = torch.where(total >= MIN_WEIGHT, weight / total.clamp_min(MIN_WEIGHT), 0.0)
    return SurfaceTaps(torch.stack(pixels, 1), weight)


def _is_same_surface(tap: Tensor, depth: Tensor, normal: Tensor, min_cosine: float) -> Tensor:
    """True where the depth and normal [n 4 h w] of a tap are those of a pixel; False for NaN."""
    same_depth = (tap[:, :1] - depth).abs() <= MAX_DEPTH_DIFFERENCE * depth
    return same_depth & ((tap[:, 1:] * normal).sum(1, keepdim=True) >= min_cosine)


def _read(image: Tensor, pixel: Tensor) -> Tensor:
    """The image [n c h w] at other pixels [n h w]."""
    flat = image.flatten(2)
    index = pixel.flatten(1)[:, None].expand(-1, image.shape[1], -1)
    return flat.gather(2, index).view_as(image)


def _previous_position(motion: Tensor, depth: Tensor, axis: int) -> Tensor:
    """Each pixel's x (axis 0) or y (axis 1) in the last frame; outside if it is not finite."""
    n, _, h, w = depth.shape
    pixels = torch.arange((w, h)[axis], device=depth.device, dtype=depth.dtype)
    current = (pixels if axis == 0 else pixels[:, None]).expand(n, h, w)
    outside = -4.0  # a position whose taps are all outside
    moved = (current + motion[:, axis]).nan_to_num(outside, outside, outside)
    return moved.clamp(outside, max(h, w) + 1.0)
