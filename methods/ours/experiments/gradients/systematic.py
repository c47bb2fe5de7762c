"""Systematic rounding: whole counts whose possible outcomes can be listed.

The benchmark rounds by a tournament (rlbench.ops.dither), which has too many outcomes to list. Here
one random offset decides: fractional parts are laid end to end along a Hilbert curve, and marks at
a distance of one, shifted by the offset, choose the pixels that are rounded up (Madow 1949). Both
roundings have an exact sum and the same mean count in each pixel, and spread samples evenly.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import torch
from jaxtyping import Float, Int
from torch import Tensor

from methods.ours.experiments.known_optimum import ToyProblem, toy_density
from rlbench.ops.dither import THRESHOLD_BITS, hash_to_integer
from rlbench.training.surrogate_gradient import relaxed_counts

__all__ = ["SystematicProblem", "hilbert_order", "round_systematically"]


@dataclass(frozen=True)
class SystematicProblem(ToyProblem):
    """A toy problem whose counts are rounded systematically."""

    def draw_counts(self, action: Float[Tensor, "n 1 h w"]) -> Int[Tensor, "n 1 h w"]:
        """Whole counts at the exact budget, also for k n images one after another."""
        seeds = self.frame.rounding_seeds
        seeds = seeds * (len(action) // len(seeds))
        low = torch.full(action.shape, self.min_samples)
        density = toy_density(action.detach().double())
        shares = relaxed_counts(density, self.spp, low, self.max_samples)
        offsets = [hash_to_integer(seed, 0) / 2**THRESHOLD_BITS for seed in seeds]
        rounded = [
            round_systematically(image, torch.tensor([offset], dtype=torch.float64))
            for image, offset in zip(shares, offsets, strict=True)
        ]
        return torch.cat(rounded).long()


def round_systematically(
    shares: Float[Tensor, "1 h w"], offsets: Float[Tensor, " k"]
) -> Float[Tensor, "k 1 h w"]:
    """The counts of each offset in [0, 1], for shares (float64) with a whole sum."""
    order = hilbert_order(*shares.shape[-2:])
    lower = shares.floor()
    ends = (shares - lower).flatten()[order].cumsum(0)
    marks = (ends + offsets[:, None]).floor()
    marks[:, -1] = ends[-1].round()
    counts = lower.flatten().repeat(len(marks), 1)
    counts[:, order] += marks.diff(dim=1, prepend=marks.new_zeros(len(marks), 1))
    return counts.view(-1, *shares.shape)


@lru_cache(maxsize=8)
def hilbert_order(h: int, w: int) -> Int[Tensor, " _"]:
    """Flat indices of the h * w pixels in the order of a Hilbert curve through the image.

    Uses the curve of the smallest enclosing power-of-two square, without the pixels outside the
    image. The position on the curve is computed from row and column bit by bit (Hilbert 1891; as in
    Warren 2012, Hacker's Delight, section 16.2).

    >>> hilbert_order(2, 2).tolist()
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
    return position.argsort()
