"""The gradient through stochastic rounding: the image's error with and without another sample."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from methods.ours.policy.learner import AllocationProblem, SamplerLearner

TINY = 1e-12  # avoids a division by zero where nothing is switched, or nothing changes
IMAGE = (0, 2, 3, 4)  # dimensions of [k n 1 h w] that belong to one image


class SwitchedBlocks(NamedTuple):
    """Blocks of pixels whose counts are rounded up in one image of a pair and down in the other.

    A lattice of square cells covers each image. The block is the centre of its cell.
    """

    cell: Int[Tensor, "k n 1 h w"]  # number of each pixel's cell
    is_block: Bool[Tensor, "k n 1 h w"]  # does the pixel belong to its cell's block?
    sign: Float[Tensor, "k n 1 h w"]  # 1 if the cell is up in the first image, else -1

    def sum_cells(self, values: Float[Tensor, "k n 1 h w"]) -> Float[Tensor, "k n 1 h w"]:
        """At each pixel, the sum over the pixel's cell."""
        cell, flat = self.cell.flatten(2), values.flatten(2)
        sums = flat.new_zeros(*flat.shape[:2], int(cell.max()) + 1).scatter_add(2, cell, flat)
        return sums.gather(2, cell).view(values.shape)


@dataclass
class StochasticLearner(SamplerLearner):
    """Differences of the error over the next sample, through the chance of drawing it.

    A planned count is mu = m + p, with m whole. The pixel draws m + 1 samples with probability p
    and else m, so the expected error E of the image is linear in p between whole counts:

        dE/dmu = E[error | m + 1] - E[error | m] = D

    Training has the next sample in the pool, so D is measured on pairs of images instead of waiting
    for the rounding to draw it. A score function would estimate the same D from the bit b that was
    drawn, by error * (b - p) / (p (1 - p)), whose variance grows without bound towards whole
    counts. Some pixels are set to m + 1 in one image and to m in the other, by a random sign; all
    others keep the counts that rounding gave them. Both images share all other samples. The pixels
    are blocks on a lattice with a random offset, one block in the centre of each square cell of
    block + 2 margin pixels. A cell's error is credited to its block, so effects do not overlap
    within the margin. Each pixel is switched with equal probability, and weighted by its inverse.
    The gradient of mu, with its normalisation to the budget, takes D to the action,
    and removes what the budget cancels, so that the mean action needs no penalty against drift.

    The estimate is unbiased for the mean over pixels of D dmu, with block 1, counts below 4 and no
    price, if it is not standardised and no sample changes the image beyond the margin. What is
    biased, and by how much:

    - Rounding at an exact budget is not independent from pixel to pixel. D is taken with the other
      pixels' counts as drawn, which is exact where the errors of pixels add up (no filter, or a
      filter with constant weights), and ignores how one pixel's rounding changes the others' where
      the denoiser reads counts.
    - A change beyond the margin is not credited to its block; behind the U-Net of `ours` that is a
      large part. What reaches other cells is noise of mean zero, because signs are independent.
    - From 4 samples on, D is a secant over 1 + 2 floor(m * stride) samples, because one of many
      samples changes less than noise hides. For an error of variance / n it is too long by a factor
      of 1 / (1 - stride^2) at most, 7 % at 0.25.
    - A block of several pixels is switched at once, and its pixels share the mean: less noise by
      its area, but D is blurred over the block, and a second sample in a block is worth less than
      the first. At a small fraction of a sample per pixel lengths are too short.
    - The price, the mean D weighted by mu, is subtracted. The budget would subtract it in any case,
      from the pixels that were not switched too, with more noise. It is estimated from the same
      blocks: too short by one part in their number.
    - Standardised, as in training, it has no length, so that hard scenes and high budgets do not
      dominate; and it is clipped, which ignores a part of rare, large effects. Without clipping one
      outlier can drive the map to where tanh is flat, and it stays there.
    - At a whole count the expected error has a kink; D is then the slope above it.

    Differs from Bálint et al. 2026 (Forget Superresolution, Sample Adaptively), whose estimator is
    not published in what could be read: "the gradient goes through the rounding in expectation".
    """

    block: int = 8  # pixels, side of a block; 1 is free of the block's bias, with more noise
    margin: int = 4  # pixels around a block whose error is credited to it
    pairs: int = 2  # pairs of images for one gradient, with different offsets of the lattice
    stride: float = 0.25  # of the count, by which a difference extends to both sides
    price_weight: float = 1.0  # share of the price that is subtracted; 0 is an ablation
    is_standardized: bool = True  # divide by the mean |D|, clip, and take shares of the budget?
    clip: float = 3.0  # times the mean |D| of the image, if standardised

    @property
    def spacing(self) -> int:
        """Side of a cell, pixels."""
        return self.block + 2 * self.margin

    def loss(self, problem: AllocationProblem, generator: torch.Generator) -> Float[Tensor, ""]:
        """A scalar with the estimated gradient; its value is zero."""
        mean = problem.act()
        counts = problem.relaxed_counts(mean)
        blocks = self.draw_blocks(mean, generator)
        slope = self._slope(problem, mean.detach(), counts.detach(), blocks)
        change = counts - counts.detach()  # zero, with a gradient
        if self.is_standardized:
            size = _mean(slope.abs(), blocks.is_block).clamp_min(TINY)
            slope = (slope / size).clamp(-self.clip, self.clip)
            change = change / max(problem.spp, TINY)
        else:
            change = change * (self.spacing / self.block) ** 2
        gain = (slope * blocks.is_block).mean(0)
        return (gain * change).mean()

    def draw_blocks(
        self, images: Float[Tensor, "n 1 h w"], generator: torch.Generator
    ) -> SwitchedBlocks:
        """Random blocks for images of this shape; pairs have different offsets, if there are."""
        n, _, h, w = images.shape
        side = self.spacing
        order = torch.rand(n, side**2, generator=generator).argsort(1)
        offset = order.repeat(1, -(-self.pairs // side**2))[:, : self.pairs].T
        row = (offset // side)[..., None, None, None] + torch.arange(h)[:, None]
        column = (offset % side)[..., None, None, None] + torch.arange(w)
        columns = (w + side - 2) // side + 1
        cell = row // side * columns + column // side
        inside = [
            (at % side >= self.margin) & (at % side < side - self.margin) for at in (row, column)
        ]
        cells = columns * ((h + side - 2) // side + 1)
        signs = 2.0 * torch.randint(2, (self.pairs, n, cells), generator=generator) - 1
        sign = signs.gather(2, cell.flatten(2)).view(cell.shape)
        parts = (cell, inside[0] & inside[1], sign)
        return SwitchedBlocks(*(part.to(images.device) for part in parts))

    def _slope(
        self, problem: AllocationProblem, action: Tensor, planned: Tensor, blocks: SwitchedBlocks
    ) -> Tensor:
        """[k n 1 h w] D of each cell, less the price."""
        lower, upper = self.bracket(planned, problem.min_samples, problem.max_samples)
        drawn, is_up = problem.draw_counts(action), blocks.sign > 0
        first = torch.where(is_up, upper, lower).where(blocks.is_block, drawn)
        second = torch.where(is_up, lower, upper).where(blocks.is_block, drawn)
        errors = problem.evaluate_counts(torch.cat((first, second)))
        change = blocks.sign * (errors[: self.pairs] - errors[self.pairs :])
        samples = blocks.sum_cells(((upper - lower) * blocks.is_block).to(change))
        slope = blocks.sum_cells(change) / samples.clamp_min(1)
        is_free = (planned > problem.min_samples) & (planned < problem.max_samples)
        return slope - self.price_weight * _mean(slope, planned * (is_free & blocks.is_block))

    def bracket(
        self, planned: Float[Tensor, "n 1 h w"], least: int, most: int
    ) -> tuple[Int[Tensor, "n 1 h w"], Int[Tensor, "n 1 h w"]]:
        """Whole counts below and above the planned ones, within [least, most].

        >>> StochasticLearner().bracket(torch.tensor([[[[0.3, 2.5, 8.5]]]]), 0, 12)
        (tensor([[[[0, 2, 6]]]]), tensor([[[[ 1,  3, 11]]]]))
        """
        below = planned.floor()
        aside = (self.stride * below).floor()
        counts = (below - aside, below + 1 + aside)
        lower, upper = (count.clamp(least, most).long() for count in counts)
        return lower, upper


def _mean(values: Tensor, weight: Tensor) -> Tensor:
    """[1 n 1 1 1] Weighted mean of each image over its pairs."""
    total = weight.sum(IMAGE, keepdim=True).clamp_min(TINY)
    return (weight * values).sum(IMAGE, keepdim=True) / total
