"""A toy frame whose expected error, and its gradient through whole counts, are known exactly.

The benchmark rounds by a tournament (rlbench.ops.dither), which has too many outcomes to list. Here
one random offset decides: fractional parts are laid end to end along a Hilbert curve, and marks at
a distance of one, shifted by the offset, choose the pixels that are rounded up (Madow 1949). Both
roundings have an exact sum and the same mean count in each pixel, and spread samples evenly.

As the offset passes from 0 to 1, the counts change once per pixel: these outcomes and their
probabilities are listed, and the expected error of each is known in closed form. The probabilities
are differentiable in the shares of the budget, hence so is their sum.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn
from torch.nn import functional as F

from methods.ours.gradients.toy_problem import (
    Direct,
    Filter,
    FixedFilter,
    Mode,
    ToyFrame,
    ToyProblem,
    toy_density,
    toy_frames,
)
from rlbench.ops.dither import THRESHOLD_BITS, hash_to_integers
from rlbench.training.surrogate_gradient import relaxed_counts

SIDE = 24  # rows and columns of the image
TILE = 6  # rows and columns of a tile: the density has one parameter per tile, 16 in total
BUDGETS = (0.0625, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 64.0)  # samples per pixel
ACTION_RANGE = 0.3  # of the action at which gradients are taken; the density varies by 0.7 to 1.3
MIN_STORED = 8  # samples per pixel, for low budgets
SCENE_SEED = 11

DENOISERS: Mapping[str, Mode] = {
    "no filter": Direct(),
    "fixed filter": FixedFilter(),
    "count-weighted filter": Filter(),
}


class TileAction(nn.Module):
    """An action that differs from pixel to pixel, plus one parameter per tile, at first zero.

    Each of n images has parameters of its own, so that one backward pass gives n gradients.
    """

    def __init__(self, n: int) -> None:
        """For n images."""
        super().__init__()
        self.parameters_per_tile = nn.Parameter(torch.zeros(n, 1, SIDE // TILE, SIDE // TILE))

    def forward(self, observation: Tensor) -> Float[Tensor, "n 1 h w"]:
        """The action; the observation has no effect on it."""
        offsets = self.parameters_per_tile.repeat_interleave(TILE, 2).repeat_interleave(TILE, 3)
        return _base_action() + offsets


def make_problem(denoiser: Mode, spp: float, n: int, generator: torch.Generator) -> ToyProblem:
    """The same scene n times, each with samples, prior and rounding of its own.

    Samples are log-normal around a known truth with a known deviation, and a pixel is estimated by
    the mean of its samples and a prior that weighs half a sample.
    """
    scene = _scene()
    repeated = {
        name: getattr(scene, name).expand(n, -1, -1, -1)
        for name in ("observation", "truth", "sigma", "prior")
    }
    stored = max(MIN_STORED, round(2 * spp) + MIN_STORED)  # more than any action asks for
    frame = replace(scene, **repeated).resample(generator, stored)
    return SystematicProblem(frame, denoiser, TileAction(n), spp)


def tile_parameters(problem: ToyProblem) -> Float[Tensor, "n 1 _ _"]:
    """The parameters of the density of each image, which gradients belong to."""
    assert isinstance(problem.sampler, TileAction)
    return problem.sampler.parameters_per_tile


@lru_cache
def _scene() -> ToyFrame:
    return next(toy_frames(SCENE_SEED, 1, SIDE))


@lru_cache
def _base_action() -> Tensor:
    """[1 1 h w] Fixed values in [-ACTION_RANGE, ACTION_RANGE] with mean zero, half of them smooth.

    A mean of zero leaves no gradient to the learners' penalty on the mean action.
    """
    generator = torch.Generator().manual_seed(SCENE_SEED)
    smooth = F.interpolate(torch.rand(1, 1, 4, 4, generator=generator), SIDE, mode="bilinear")
    action = smooth + torch.rand(1, 1, SIDE, SIDE, generator=generator)
    action = action - action.mean()
    return action * (ACTION_RANGE / action.abs().max())


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
        offsets = hash_to_integers(torch.tensor(seeds), levels=1).double() / 2**THRESHOLD_BITS
        rounded = [
            round_systematically(image, offset)
            for image, offset in zip(shares, offsets.view(-1, 1), strict=True)
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


class RoundingOutcomes(NamedTuple):
    """All counts that one image's shares can be rounded to."""

    counts: Float[Tensor, "k 1 h w"]
    probabilities: Float[Tensor, " k"]  # differentiable in the shares
    offsets: Float[Tensor, " k"]  # in [0, 1]; the middle of those that lead to the counts


def list_outcomes(shares: Float[Tensor, "1 h w"]) -> RoundingOutcomes:
    """The outcomes of `SystematicProblem.draw_counts` for shares (float64) with a whole sum.

    Cumulative sums of the fractional parts, in the order of the Hilbert curve, are the marks at
    which an offset decides whether a pixel is rounded up.

    >>> outcomes = list_outcomes(torch.tensor([[[0.25, 1.75]]], dtype=torch.float64))
    >>> outcomes.counts.flatten(1).tolist(), outcomes.probabilities.tolist()
    ([[0.0, 2.0], [1.0, 1.0]], [0.75, 0.25])
    """
    order = hilbert_order(*shares.shape[-2:])
    ends = (shares - shares.detach().floor()).flatten()[order].cumsum(0)
    thresholds = 1 - (ends[:-1] - ends[:-1].detach().floor())  # the last end is whole
    edges = torch.cat((ends.new_zeros(1), thresholds.sort().values, ends.new_ones(1)))
    probabilities = edges.diff()
    offsets = ((edges[1:] + edges[:-1]) / 2).detach()
    return RoundingOutcomes(round_systematically(shares.detach(), offsets), probabilities, offsets)


def expected_error(
    problem: ToyProblem, action: Float[Tensor, "n 1 h w"], image: int = 0
) -> Float[Tensor, ""]:
    """Expected mean squared error of one image's action, over samples, prior and rounding."""
    shares = _shares(problem, action)[image]
    outcomes = list_outcomes(shares)
    errors = _errors(problem, outcomes.counts, image).mean((1, 2, 3))
    return (outcomes.probabilities * errors).sum()


def relaxed_error(
    problem: ToyProblem, action: Float[Tensor, "n 1 h w"], image: int = 0
) -> Float[Tensor, ""]:
    """The error as if counts were real numbers: rounding adds to it, most at low budgets."""
    return _errors(problem, _shares(problem, action)[image, None], image).mean()


def true_gradient(
    problem: ToyProblem, action: Float[Tensor, "n 1 h w"] | None = None, image: int = 0
) -> Float[Tensor, " p"]:
    """The gradient of `expected_error` with respect to the sampler's parameters of one image.

    `action` is the one at which the gradient is taken; None is the sampler's.
    """
    mean = problem.act()
    at = mean if action is None else action + mean - mean.detach()  # with the gradient of the mean
    (gradient,) = torch.autograd.grad(
        expected_error(problem, at, image), [tile_parameters(problem)]
    )
    return gradient[image].flatten()


def _shares(problem: ToyProblem, action: Tensor) -> Tensor:
    low = torch.full(action.shape, problem.min_samples)
    density = toy_density(action.double())
    return relaxed_counts(density, problem.spp, low, problem.max_samples)


def _errors(problem: ToyProblem, counts: Tensor, image: int) -> Tensor:
    sigma, truth = problem.frame.sigma[image, None], problem.frame.truth[image, None]
    return problem.mode.expected_error(sigma.double(), truth.double(), counts)
