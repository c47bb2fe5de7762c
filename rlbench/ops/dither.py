"""Choosing whole pixels in proportion to fractions of a sample, evenly spread over the image."""

from __future__ import annotations

from functools import lru_cache

import torch
from jaxtyping import Bool, Int
from torch import Tensor


def systematic_sample(weight: Int[Tensor, "h w"], number: int, key: int) -> Bool[Tensor, "h w"]:
    """About `number` pixels, each with probability `number` * weight / (sum of weights).

    Systematic sampling (Madow 1949) along a Hilbert curve, as halftoning does it (Velho and Gomes
    1991): weights are laid end to end, and `number` equidistant marks, shifted by a hash of `key`,
    pick the pixels that they fall in. Neighbours on the curve are neighbours in the image, so each
    part of the image gets its share to within a sample or so. Exactly `number` are chosen if none
    weighs more than the distance of two marks; else fewer, at least one. Integers and single IEEE
    operations only: the same on every device.
    """
    h, w = weight.shape
    order = hilbert(h, w, weight.device)
    along = weight.flatten()[order]
    ends = along.cumsum(0)
    marks = (ends.double() * (number / float(ends[-1])) + shift(key)).floor()
    marks[-1] = number
    inside = (torch.diff(marks, prepend=marks.new_zeros(1)) > 0) & (along > 0)
    return torch.empty_like(inside).scatter_(0, order, inside).view(weight.shape)


@lru_cache(maxsize=8)
def hilbert(h: int, w: int, device: torch.device) -> Int[Tensor, " _"]:
    """Flat indices of the pixels of an image, in the order of a Hilbert curve through it.

    The curve of the smallest power of two that holds the image, without the pixels outside it.
    Position on the curve from row and column, bit by bit: Hilbert 1891, as in Warren 2012,
    Hacker's Delight, section 16.2.
    """
    rows, columns = torch.meshgrid(torch.arange(h), torch.arange(w), indexing="ij")
    x, y, along = columns.flatten(), rows.flatten(), torch.zeros(h * w, dtype=torch.int64)
    for bit in reversed(range((max(h, w) - 1).bit_length())):
        right, down = (x >> bit) & 1, (y >> bit) & 1
        along = (along << 2) | ((3 * right) ^ down)
        turned, mirrored = down == 0, (down == 0) & (right == 1)
        x, y = (torch.where(mirrored, ~side, side) for side in (x, y))
        x, y = torch.where(turned, y, x), torch.where(turned, x, y)
    return along.argsort().to(device)


def shift(key: int) -> float:
    """A number in [0, 1) from a key: two rounds of a multiplicative hash, top 32 bits."""
    for factor in (0x9E3779B97F4A7C15, 0xD1342543DE82EF95):
        key = (key * factor + 1) & (2**64 - 1)
        key ^= key >> 32
    return (key >> 32) / 2**32
