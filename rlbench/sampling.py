"""Buying samples: a wish becomes whole samples that cost exactly the budget."""

from __future__ import annotations

import torch
from jaxtyping import Float, Int
from torch import Tensor

from rlbench.errors import RlbenchError
from rlbench.frames import Pool, Samples
from rlbench.ops.dither import systematic_sample

TOLERANCE = 1e-3  # samples by which the shares of an image may miss the budget before rounding
STEPS = 64  # most refinements of the multiplier; 5 to 10 are usual
FRACTION = 2**32  # parts of a sample that remainders are counted in


class BudgetError(RlbenchError, ValueError):
    """A density or a budget that cannot be turned into counts."""


def draw_pilot(pool: Pool, spp: float) -> Samples:
    """The samples of a frame before its method is asked: `spp` per pixel, evenly; often none."""
    bought = pool.empty()
    if spp == 0:
        return bought
    return draw_samples(pool, bought, torch.ones_like(bought.counts, dtype=torch.float32), spp)


def draw_samples(
    pool: Pool,
    samples: Samples,
    density: Float[Tensor, "n 1 h w"],
    target_spp: float,
    min_samples: int = 0,
    max_samples: int | None = None,
    discard_pilot: bool = False,
) -> Samples:
    """Samples that follow `density`, `upto` samples per pixel on average, those at hand included.

    No pixel gets fewer than `floor`, or more than `cap` or than the pool has of it. If what is
    bought now has to be `fresh`, those at hand are paid for all the same, but density, floor and
    cap speak of the new ones alone. Raises BudgetError if the density is not finite and >= 0, or if
    floor, cap and budget disagree.
    """
    n, h, w = pool.size
    if density.shape != (n, 1, h, w):
        raise BudgetError(f"density has shape {list(density.shape)}, the frame {[n, 1, h, w]}")
    cost, wish = round(target_spp * h * w), density.detach()
    max_samples = pool.max_samples if max_samples is None else min(max_samples, pool.max_samples)
    if discard_pilot:
        held, low = samples.counts, torch.full_like(samples.counts, min_samples)
        paid = int(held[0].sum())  # as much in every image
        keys = tuple(
            key + 1 for key in pool.rounding_seeds
        )  # or it would round up where the pilot did
        counts = held + allocate_counts(
            wish, cost - paid, low, (pool.max_samples - held).clamp_max(max_samples), keys
        )
    else:
        counts = allocate_counts(
            wish, cost, samples.counts.clamp_min(min_samples), max_samples, pool.rounding_seeds
        )
    return Samples(pool.read(samples, counts), counts)


def allocate_counts(
    density: Float[Tensor, "n 1 h w"],
    cost: int,
    low: Int[Tensor, "n 1 h w"],
    high: int | Int[Tensor, "n 1 h w"],
    keys: tuple[int, ...],
) -> Int[Tensor, "n 1 h w"]:
    """Whole counts in [low, high] that follow `density` and sum to exactly `cost` in each image.

    The share of a pixel is clip(k * density, low, high) with k such that shares sum to `cost`. Its
    count is the share rounded down or up, up with the probability of the remainder and in even
    spread over the image (rlbench.ops.dither), so that counts follow density below one sample too:
    to give what is left to the largest remainders would flatten any density between 0.5 and 1.5
    at 1 spp, and follow the grain of one that is all but flat at 0.5. A density without a positive
    value is uniform. A pixel that nobody wants still takes what full pixels cannot. Differs from
    Scardigli et al. 2023, eq. in section 2.3, which rounds each pixel by itself and so misses the
    budget by up to all of it below 0.5 spp.
    """
    if not torch.isfinite(density).all():
        raise BudgetError("density has values that are not finite; a density is finite and >= 0")
    if (density < 0).any():
        raise BudgetError(f"density has negative values, down to {float(density.min()):g}")
    most = torch.as_tensor(high, device=low.device).expand_as(low)
    images = zip(density[:, 0].double(), low[:, 0], most[:, 0], keys, strict=True)
    return torch.stack([_spend_one(*image, cost) for image in images]).unsqueeze(1)


def _spend_one(density: Tensor, low: Tensor, high: Tensor, key: int, cost: int) -> Tensor:
    pixels, least, most = density.numel(), int(low.sum()), int(high.sum())
    if not least <= cost <= most or bool((low > high).any()):
        raise BudgetError(
            f"a budget of {cost} samples for {pixels} pixels does not fit: "
            f"floor and earlier passes ask for {least}, cap and pool allow {most}"
        )
    wanted = density > 0
    if not wanted.any():
        density = torch.ones_like(density)
    elif int(torch.where(wanted, high, low).sum()) < cost:  # all that is wanted is full
        low = torch.where(wanted, high, low)
        density = (~wanted).to(density.dtype)
    share = _water_fill(density / density.max(), cost, low, high)
    counts = share.floor().long()
    while (left := cost - int(counts.sum())) > 0:
        free = counts < high
        rest = ((share - counts).clamp(0, 1) * FRACTION).long().where(free, 0)
        if not rest.any():
            rest = free.long()
        counts += systematic_sample(rest, left, key)
        key += 1
    return counts


def _water_fill(density: Tensor, cost: int, low: Tensor, high: Tensor) -> Tensor:
    """clip(k * density, low, high) with the k at which it sums to `cost`, by guarded Newton steps.

    The sum rises with k and is piecewise linear. The result sums to `cost` within 1e-3, or, where
    the steps run out, to less.
    """
    floor = low.double()
    full = high.double()
    best, below, above = floor, 0.0, float("inf")
    k = cost / float(density.sum())
    for _ in range(STEPS):
        share = torch.minimum(torch.maximum(density * k, floor), full)
        excess = float(share.sum()) - cost
        if excess <= TOLERANCE:
            best, below = share, k
        else:
            above = k
        if abs(excess) <= TOLERANCE:
            break
        slope = float(density[(share > floor) & (share < full)].sum())
        guess = k - excess / slope if slope > 0 else float("inf")
        if not below < guess < above:
            guess = 2 * k if above == float("inf") else (below + above) / 2
        k = guess
    return best
