"""Sample allocation: a density becomes whole sample counts that cost exactly the budget."""

from __future__ import annotations

import math

import torch
from jaxtyping import Float, Int
from torch import Tensor

from rlbench.errors import RlbenchError
from rlbench.frames import Pool, Samples
from rlbench.ops.dither import ONE_SHARE, round_to_total

__all__ = ["BudgetError", "allocate_counts", "draw_pilot", "draw_samples"]

BUDGET_TOLERANCE = 1e-3  # samples by which the sum of shares may miss the budget before rounding
MAX_NEWTON_STEPS = 64  # for the multiplier k; 5 to 10 are usual
CUDA_NEWTON_STEPS = 12  # between two looks whether they are done


class BudgetError(RlbenchError, ValueError):
    """A density or a budget that cannot be turned into sample counts."""


def draw_pilot(pool: Pool, spp: float) -> Samples:
    """Uniform samples, `spp` per pixel, drawn before the method's first plan; none at 0 spp."""
    samples = pool.empty()
    if spp == 0:
        return samples
    return draw_samples(pool, samples, torch.ones_like(samples.counts, dtype=torch.float32), spp)


def draw_samples(
    pool: Pool,
    samples: Samples,
    density: Float[Tensor, "n 1 h w"],
    target_spp: float,
    min_samples: int = 0,
    max_samples: int | None = None,
    discard_pilot: bool = False,
) -> Samples:
    """`samples` and more, drawn by `density`, `target_spp` samples per pixel on average in total.

    The total of each image is exactly round(target_spp * h * w). Each pixel gets at least
    `min_samples`, and at most `max_samples` and what the pool holds. With `discard_pilot`, earlier
    samples still count towards the total, but density and limits apply to the new samples alone.

    Raises BudgetError if the density has another shape than the frame, is negative or not finite,
    or if limits and budget contradict each other.
    """
    n, h, w = pool.size
    if density.shape != (n, 1, h, w):
        raise BudgetError(
            f"density has shape {list(density.shape)}, the frame {[n, 1, h, w]}; "
            "return one value per pixel"
        )
    density, drawn = density.detach(), samples.counts
    total_samples = round(target_spp * h * w)
    limit = pool.max_samples if max_samples is None else min(max_samples, pool.max_samples)
    if discard_pilot:
        total_samples -= int(drawn[0].sum())  # the same in every image
        low = torch.full_like(drawn, min_samples)
        high = (pool.max_samples - drawn).clamp_max(limit)
        seeds = tuple(seed + 1 for seed in pool.rounding_seeds)  # round up other pixels than before
        counts = drawn + allocate_counts(density, total_samples, low, high, seeds)
    else:
        low = drawn.clamp_min(min_samples)
        counts = allocate_counts(density, total_samples, low, limit, pool.rounding_seeds)
    return Samples(pool.read(samples, counts), counts)


def allocate_counts(
    density: Float[Tensor, "n 1 h w"],
    total_samples: int,
    min_counts: Int[Tensor, "n 1 h w"],
    max_counts: int | Int[Tensor, "n 1 h w"],
    rounding_seeds: tuple[int, ...],
) -> Int[Tensor, "n 1 h w"]:
    """Sample counts within [min, max] that follow `density` and sum to `total_samples` per image.

    The share of a pixel is clip(k * density, min, max), with k such that the shares of an image sum
    to `total_samples` (water-filling). Its count is the share rounded down or up: up with the
    probability of the fractional part, spread evenly over the image (rlbench.ops.dither). The last
    argument holds one rounding seed per image.

    So counts follow the density below one sample per pixel too. Rounding up the largest remainders
    instead would flatten any density between 0.5 and 1.5 at 1 spp, and would follow the noise of a
    nearly constant density at 0.5. A density without a positive value is uniform. Where all pixels
    with positive density are full, the rest of the budget goes to the others. Differs from
    Scardigli et al. 2023, equation in section 2.3, which rounds each pixel by itself and so misses
    the budget by up to all of it below 0.5 spp.

    Raises BudgetError if the density is negative or not finite, or if limits and budget contradict
    each other.

    >>> density = torch.tensor([0.0, 1.0, 2.0, 3.0]).view(1, 1, 1, 4)
    >>> zero = torch.zeros(1, 1, 1, 4, dtype=torch.int64)
    >>> allocate_counts(density, 6, zero, 8, (0,)).flatten().tolist()
    [0, 1, 2, 3]
    """
    images = density[:, 0].double()
    high = torch.as_tensor(max_counts, device=min_counts.device).expand_as(min_counts)[:, 0]
    low = min_counts[:, 0]
    if (share := _equal_share(images, total_samples, low, high)) is not None:
        return torch.full_like(min_counts, share)
    density, low = _fill_first(images, total_samples, low, high)
    shares = _water_fill(density / density.amax((1, 2), True), total_samples, low, high)
    return _round_shares(shares, total_samples, high, rounding_seeds).unsqueeze(1)


def _equal_share(density: Tensor, total_samples: int, low: Tensor, high: Tensor) -> int | None:
    """The count of every pixel where density and budget give all the same whole one, else None.

    Raises BudgetError as `allocate_counts` does. All that a GPU has to report comes in one message.
    """
    none_free = (low > high).any()
    reported = (density.amin(), density.amax(), low.max(), high.min(), none_free)
    sums = (low.sum((1, 2)).max(), high.sum((1, 2)).min())
    smallest, largest, lowest, highest, contradict, least, most = torch.stack(
        [value.double() for value in (*reported, *sums)]
    ).tolist()
    if not math.isfinite(smallest) or not math.isfinite(largest):
        raise BudgetError("density has values that are not finite; it must be finite and >= 0")
    if smallest < 0:
        raise BudgetError(f"density has negative values, down to {smallest:g}; it must be >= 0")
    if not least <= total_samples <= most or contradict:
        raise BudgetError(
            f"a budget of {total_samples} samples for {density[0].numel()} pixels does not fit: "
            f"min_samples and earlier passes need {least:.0f}, max_samples and the pool allow "
            f"{most:.0f}"
        )
    share, rest = divmod(total_samples, density[0].numel())
    return share if smallest == largest and not rest and lowest <= share <= highest else None


def _fill_first(
    density: Tensor, total_samples: int, low: Tensor, high: Tensor
) -> tuple[Tensor, Tensor]:
    """Density and least counts [n h w], where the pixels that the density names cannot take all.

    Without a positive value the density is uniform. Where all pixels with a positive density will
    be full, they are filled, and the others share the rest evenly.
    """
    positive = density > 0
    has_none = ~positive.flatten(1).any(1)[:, None, None]
    room = torch.where(positive, high, low).sum((1, 2), keepdim=True)
    are_full = ~has_none & (room < total_samples)
    density = torch.where(are_full, (~positive).to(density.dtype), density)
    return density.where(~has_none, 1.0), torch.where(are_full & positive, high, low)


def _water_fill(density: Tensor, total_samples: int, low: Tensor, high: Tensor) -> Tensor:
    """clip(k * density, low, high) with k of each image [h w] such that it sums to `total_samples`.

    The sum is piecewise linear and increases with k; k is found by Newton steps within a bracket.
    The result sums to `total_samples` within 1e-3, or to less if the steps run out. A GPU looks
    only now and then whether the steps are done: a step costs it less than an answer.
    """
    low, high = low.double(), high.double()
    best, k = low, total_samples / density.sum((1, 2), keepdim=True)
    below, above = torch.zeros_like(k), torch.full_like(k, math.inf)  # bracket of k
    done = torch.zeros_like(k, dtype=torch.bool)
    interval = CUDA_NEWTON_STEPS if density.is_cuda else 1
    for step in range(1, MAX_NEWTON_STEPS + 1):
        shares = torch.minimum(torch.maximum(density * k, low), high)
        excess = shares.sum((1, 2), keepdim=True) - total_samples
        fits = (excess <= BUDGET_TOLERANCE) & ~done
        best = torch.where(fits, shares, best)
        done |= excess.abs() <= BUDGET_TOLERANCE
        if step % interval == 0 and bool(done.all()):
            break
        below, above = torch.where(fits, k, below), torch.where(fits | done, above, k)
        slope = density.where((shares > low) & (shares < high), 0.0).sum((1, 2), keepdim=True)
        guess = torch.where(slope > 0, k - excess / slope, math.inf)
        halved = torch.where(above == math.inf, 2 * k, (below + above) / 2)
        guess = guess.where((below < guess) & (guess < above), halved)
        k = torch.where(done, k, guess)
    return best


def _round_shares(
    shares: Tensor, total_samples: int, high: Tensor, seeds: tuple[int, ...]
) -> Tensor:
    """Whole counts that sum to `total_samples`: each share rounded down or up, at most `high`.

    What the shares lack of the total is first added in proportion to the room below `high`.
    """
    fixed = (shares * ONE_SHARE).long()
    lacking = total_samples * ONE_SHARE - fixed.sum((1, 2), keepdim=True)
    room = high * ONE_SHARE - fixed
    part = lacking.double() / room.sum((1, 2), keepdim=True).clamp_min(1)
    is_far = lacking.abs() >= ONE_SHARE // 2
    fixed = fixed + torch.where(is_far, (room.double() * part).long(), 0)
    return round_to_total(fixed, total_samples, seeds)
