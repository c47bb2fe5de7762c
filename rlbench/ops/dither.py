"""Systematic sampling along a Hilbert curve: distribute whole samples evenly over an image."""

from __future__ import annotations

from functools import lru_cache

import torch
from jaxtyping import Bool, Int
from torch import Tensor

__all__ = ["hash_to_unit_interval", "hilbert_order", "systematic_sample"]


def systematic_sample(weights: Int[Tensor, "h w"], count: int, seed: int) -> Bool[Tensor, "h w"]:
    """Mask of about `count` pixels, each chosen with probability count * weight / sum(weights).

    Systematic sampling (Madow 1949) along a Hilbert curve, as in halftoning (Velho and Gomes 1991):
    the weights are laid end to end along the curve, and `count` equidistant marks, shifted by a
    hash of `seed`, choose the pixels that they fall into. Neighbours on the curve are neighbours in
    the image, so each region of the image gets its share to within about one sample.

    Exactly `count` pixels are chosen if no weight exceeds the distance between two marks; otherwise
    fewer, but at least one. Weights are >= 0 with a positive sum. Uses only integers and single
    IEEE operations, so that the result is the same on every device.

    >>> systematic_sample(torch.tensor([[0, 5, 0, 5]]), count=2, seed=0).tolist()
    [[False, True, False, True]]
    """
    h, w = weights.shape
    order = hilbert_order(h, w, weights.device)
    along_curve = weights.flatten()[order]
    ends = along_curve.cumsum(0)
    marks = (ends.double() * (count / float(ends[-1])) + hash_to_unit_interval(seed)).floor()
    marks[-1] = count
    chosen = (torch.diff(marks, prepend=marks.new_zeros(1)) > 0) & (along_curve > 0)
    return torch.empty_like(chosen).scatter_(0, order, chosen).view(weights.shape)


@lru_cache(maxsize=8)
def hilbert_order(h: int, w: int, device: torch.device) -> Int[Tensor, " _"]:
    """Flat indices of the h * w pixels in the order of a Hilbert curve through the image.

    Uses the curve of the smallest enclosing power-of-two square, without the pixels outside the
    image. The position on the curve is computed from row and column bit by bit (Hilbert 1891; as in
    Warren 2012, Hacker's Delight, section 16.2).

    >>> hilbert_order(2, 2, torch.device("cpu")).tolist()
    [0, 2, 3, 1]
    """
    rows, columns = torch.meshgrid(torch.arange(h), torch.arange(w), indexing="ij")
    x, y, position = columns.flatten(), rows.flatten(), torch.zeros(h * w, dtype=torch.int64)
    for bit in reversed(range((max(h, w) - 1).bit_length())):
        right, down = (x >> bit) & 1, (y >> bit) & 1
        position = (position << 2) | ((3 * right) ^ down)
        transposed, mirrored = down == 0, (down == 0) & (right == 1)
        x, y = (torch.where(mirrored, ~side, side) for side in (x, y))
        x, y = torch.where(transposed, y, x), torch.where(transposed, x, y)
    return position.argsort().to(device)


def hash_to_unit_interval(seed: int) -> float:
    """A number in [0, 1): the top 32 bits after two rounds of a multiplicative hash of `seed`."""
    for factor in (0x9E3779B97F4A7C15, 0xD1342543DE82EF95):
        seed = (seed * factor + 1) & (2**64 - 1)
        seed ^= seed >> 32
    return (seed >> 32) / 2**32
