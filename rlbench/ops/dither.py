"""Dithered rounding: fractional shares become whole counts with an exact sum, spread evenly."""

from __future__ import annotations

from collections.abc import Sequence
from types import ModuleType

import numpy as np
import torch
from jaxtyping import Int
from torch import Tensor

from rlbench.ops.asking import may_ask
from rlbench.ops.upload import upload

__all__ = ["ONE_SHARE", "hash_to_integers", "round_to_total"]

SHARE_BITS = 32
ONE_SHARE = 2**SHARE_BITS  # a share of one sample, as an integer
FRACTION = ONE_SHARE - 1  # mask of a share's fractional part
THRESHOLD_BITS = 30  # threshold times fraction must stay below 2^63
HASH_FACTORS = (0x9E3779B97F4A7C15 - 2**64, 0xD1342543DE82EF95 - 2**64)  # odd, as signed integers
SMALL_LEVEL = 4096  # parts up to which numpy is quicker than torch, which takes longer for a call

Array = Tensor | np.ndarray


def round_to_total(
    shares: Int[Tensor, "n h w"],
    total: int | Int[Tensor, "n 1 1"],
    seeds: Sequence[int] | Int[Tensor, " n"],
) -> Int[Tensor, "n h w"]:
    """Whole counts that sum to `total` in each image: each share rounded down or up, without bias.

    `shares` are in units of 2^-32 (`ONE_SHARE` is one) and must sum to within one of `total`. A
    share is rounded up with the probability of its fractional part, over seeds; there is one seed
    per image, in [0, 2^57). Seeds and total may be tensors, so that a recorded frame takes others.

    The pivotal method of Deville and Tille 1998, with a fixed tournament over the image (spatially
    balanced sampling, as in Stevens and Olsen 2004): halves of the image are halved in turn, along
    both axes, down to pixels. Each part gets its share rounded down or up, and divides its count
    between its two halves in the same way. So every aligned square of 2^k pixels gets its share to
    within one sample, and a change in one pixel moves few samples of others: some twenty in 128 x
    128 pixels, while marks along a curve through the image would all shift. Thresholds alternate
    between neighbours, so that half a share per pixel gives a chequerboard.

    Integers only, so that the result is the same on every device.

    >>> half = torch.full((1, 2, 4), ONE_SHARE // 2)
    >>> round_to_total(half, total=4, seeds=[0]).sum(2).tolist()
    [[2, 2]]
    """
    n, h, w = shares.shape
    levels = (h - 1).bit_length() + (w - 1).bit_length()
    thresholds = hash_to_integers(upload(seeds, shares.device), levels)
    totals = total if isinstance(total, Tensor) else shares.new_full((n, 1, 1), total)
    return _divide_all(shares, totals, thresholds.view(levels, n, 1, 1))


def _divide_all(shares: Tensor, totals: Tensor, thresholds: Tensor) -> Tensor:
    """The counts of all pixels, from the totals [n 1 1] and a threshold per level [level n 1 1].

    On a processor, small levels are numpy arrays.
    """
    levels: list[Array] = [shares]
    while levels[-1].shape[1:] != (1, 1):
        parts = _add_pairs(levels[-1])
        if isinstance(parts, Tensor) and may_ask(parts) and parts[0].numel() <= SMALL_LEVEL:
            parts = parts.numpy()
        levels.append(parts)
    counts: Array = totals
    for parts, threshold in zip(levels[-2::-1], thresholds.flip(0), strict=True):
        kind = torch.asarray if isinstance(parts, Tensor) else np.asarray
        counts = _divide(kind(counts), parts, kind(threshold))
    return torch.asarray(counts)


def _library(parts: Array) -> ModuleType:
    """The library of an array, numpy or torch: what is used here, both have."""
    return torch if isinstance(parts, Tensor) else np


def _axis(parts: Array) -> int:
    """The axis along which parts are paired: the longer one, rows before columns."""
    return 2 if parts.shape[2] >= parts.shape[1] else 1


def _pairs(parts: Array) -> tuple[Array, Array]:
    """The first and the second part of each pair; the second of an odd one out is zero."""
    n, h, w = parts.shape
    if _axis(parts) == 2:
        if w % 2:
            parts = _library(parts).concatenate((parts, 0 * parts[:, :, :1]), 2)
        return parts[:, :, ::2], parts[:, :, 1::2]
    if h % 2:
        parts = _library(parts).concatenate((parts, 0 * parts[:, :1]), 1)
    return parts[:, ::2], parts[:, 1::2]


def _add_pairs(parts: Array) -> Array:
    first, second = _pairs(parts)
    return first + second


def _divide(counts: Array, parts: Array, threshold: Array) -> Array:
    """The counts of both parts of each pair, whose sum is in `counts`.

    Let a and b be the fractional parts, and `rest` the samples beyond both shares rounded down: 0
    or 1 if a + b < 1, else 1 or 2. One sample goes to the first part with a probability that
    makes its mean over `rest` and threshold equal to a.
    """
    library, axis = _library(parts), _axis(parts)
    first, second = _pairs(parts)
    floor, a, b = first >> SHARE_BITS, first & FRACTION, second & FRACTION
    rest = counts - floor - (second >> SHARE_BITS)
    both = a + b
    is_small = both < ONE_SHARE
    favourable = library.where(is_small, a, ONE_SHARE - b)
    possible = library.where(is_small, both, 2 * ONE_SHARE - both)
    wins = _alternate(threshold, counts, 3 - axis) * possible < favourable << THRESHOLD_BITS
    first_counts = floor + ((rest > 1) | ((rest == 1) & wins))
    divided = library.stack((first_counts, counts - first_counts), axis + 1)
    sides = list(counts.shape)
    sides[axis] *= 2
    result: Array = divided.reshape(sides)[:, : parts.shape[1], : parts.shape[2]]
    return result


def _alternate(threshold: Array, counts: Array, axis: int) -> Array:
    """The threshold, and its complement in every second line along `axis`."""
    one_line = counts[:, :1] if axis == 2 else counts[:, :, :1]
    thresholds = threshold + 0 * one_line
    every_second = thresholds[:, :, 1::2] if axis == 2 else thresholds[:, 1::2]
    every_second *= -1
    every_second += 2**THRESHOLD_BITS - 1
    return thresholds


def hash_to_integers(seeds: Int[Tensor, " n"], levels: int) -> Int[Tensor, "levels n"]:
    """For each level and seed a number in [0, 2^30): the top bits after two rounds of a hash.

    A round is multiplicative, modulo 2^64: products of 64-bit integers keep their low bits.
    """
    mixed = seeds * 64 + torch.arange(levels, device=seeds.device)[:, None]
    for factor in HASH_FACTORS:
        mixed = mixed * factor + 1
        mixed = mixed ^ (mixed >> 32 & 0xFFFFFFFF)
    top_bits: Tensor = mixed >> (64 - THRESHOLD_BITS) & (2**THRESHOLD_BITS - 1)
    return top_bits
