"""Sample allocation: a density becomes whole sample counts that cost exactly the budget."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor

from rlbench.errors import RlbenchError
from rlbench.frames import Pool, Samples
from rlbench.ops.asking import is_recorded, may_ask
from rlbench.ops.dither import ONE_SHARE, round_to_total
from rlbench.ops.recording import RecordedFunction
from rlbench.ops.upload import upload
from rlbench.questions import Questions

__all__ = ["BudgetError", "allocate_counts", "draw_pilot", "draw_samples"]

BUDGET_TOLERANCE = 1e-3  # samples by which the sum of shares may miss the budget before rounding
MAX_NEWTON_STEPS = 64  # for the multiplier k; 5 to 10 are usual
UNASKED_NEWTON_STEPS = 16  # where nobody may ask whether they are done; shares then fit less well


class BudgetError(RlbenchError, ValueError):
    """A density or a budget that cannot be turned into sample counts."""


def draw_pilot(pool: Pool, spp: float, questions: Questions | None = None) -> Samples:
    """Uniform samples, `spp` per pixel, drawn before the method's first plan; none at 0 spp."""
    samples = pool.empty()
    if spp == 0:
        return samples
    density = torch.ones_like(samples.counts, dtype=torch.float32)
    return draw_samples(pool, samples, density, spp, questions=questions)


def draw_samples(
    pool: Pool,
    samples: Samples,
    density: Float[Tensor, "n 1 h w"],
    total_spp: float,
    min_samples: int = 0,
    max_samples: int | None = None,
    discard_pilot: bool = False,
    questions: Questions | None = None,
) -> Samples:
    """`samples` and more, drawn by `density`, `total_spp` samples per pixel on average in total.

    The total of each image is exactly round(total_spp * h * w). Each pixel gets at least
    `min_samples`, and at most `max_samples` and what the pool holds. With `discard_pilot`, earlier
    samples still count towards the total, but density and limits apply to the new samples alone.

    Raises BudgetError if the density has another shape than the frame, is negative or not finite,
    or if limits and budget contradict each other; if `questions` are given, when these are
    answered.
    """
    n, h, w = pool.size
    if density.shape != (n, 1, h, w):
        raise BudgetError(
            f"density has shape {list(density.shape)}, the frame {[n, 1, h, w]}; "
            "return one value per pixel"
        )
    density, drawn = density.detach(), samples.counts
    total_samples = round(total_spp * h * w)
    limit = pool.max_samples if max_samples is None else min(max_samples, pool.max_samples)
    seeds = upload(pool.rounding_seeds, drawn.device)
    if discard_pilot:
        rest = total_samples - drawn.sum((2, 3))  # the same in every image
        low = torch.full_like(drawn, min_samples)
        high = (pool.max_samples - drawn).clamp_max(limit)
        seeds = seeds + 1  # round up other pixels than before
        counts = drawn + allocate_counts(density, rest, low, high, seeds, questions)
    else:
        low = drawn.clamp_min(min_samples)
        counts = allocate_counts(density, total_samples, low, limit, seeds, questions)
    return Samples(pool.read(samples, counts), counts)


def allocate_counts(
    density: Float[Tensor, "n 1 h w"],
    total_samples: int | Int[Tensor, "n 1"],
    min_counts: Int[Tensor, "n 1 h w"],
    max_counts: int | Int[Tensor, "n 1 h w"],
    rounding_seeds: Sequence[int] | Int[Tensor, " n"],
    questions: Questions | None = None,
) -> Int[Tensor, "n 1 h w"]:
    """Sample counts within [min, max] that follow `density` and sum to `total_samples` per image.

    The share of a pixel is clip(k * density, min, max), with k such that the shares of an image sum
    to `total_samples` (water-filling). Its count is the share rounded down or up: up with the
    probability of the fractional part, spread evenly over the image (rlbench.ops.dither). The
    seeds are one of each image.

    So counts follow the density below one sample per pixel too. Rounding up the largest remainders
    instead would flatten any density between 0.5 and 1.5 at 1 spp, and would follow the noise of a
    nearly constant density at 0.5. A density without a positive value is uniform. Where all pixels
    with positive density are full, the rest of the budget goes to the others. Differs from
    Scardigli et al. 2023, equation in section 2.3, which rounds each pixel by itself and so misses
    the budget by up to all of it below 0.5 spp.

    Raises BudgetError if the density is negative or not finite, or if limits and budget contradict
    each other; if `questions` are given, when these are answered. Until then such a density counts
    as 0 where it is invalid, and the total is the nearest that the limits allow.

    >>> density = torch.tensor([0.0, 1.0, 2.0, 3.0]).view(1, 1, 1, 4)
    >>> zero = torch.zeros(1, 1, 1, 4, dtype=torch.int64)
    >>> allocate_counts(density, 6, zero, 8, (0,)).flatten().tolist()
    [0, 1, 2, 3]
    """
    images, low = density[:, 0].double(), min_counts[:, 0]
    total, high = _as_images(total_samples, low), _as_images(max_counts, low).expand_as(low)
    own = questions or Questions()
    answers = own.ask(_describe(images, total, low, high), partial(_check_fit, low[0].numel()))
    if answers is None:
        images = images.nan_to_num(0, 0, 0).clamp_min(0)
        total = total.clamp(low.sum((1, 2), True), high.sum((1, 2), True))
    elif (share := _equal_share(Demand(*answers), low[0].numel())) is not None:
        return torch.full_like(min_counts, share)
    seeds = upload(rounding_seeds, images.device)
    is_recordable = images.is_cuda and not is_recorded(images)
    divide = _divide_recorded if is_recordable else _divide
    counts = divide(images, total, low, high, seeds).unsqueeze(1)
    if questions is None:
        own.answer()
    return counts


def _divide(density: Tensor, total: Tensor, low: Tensor, high: Tensor, seeds: Tensor) -> Tensor:
    """Counts [n h w] within [low, high] that follow a density and sum to `total` [n 1 1]."""
    density, low = _fill_first(density, total, low, high)
    shares = _water_fill(density / density.amax((1, 2), True), total, low, high)
    return _round_shares(shares, total, high, seeds)


_divide_recorded = RecordedFunction(_divide)  # hundreds of small steps, one launch on a GPU


class Demand(NamedTuple):
    """What a density and a budget ask for, over all images of a batch."""

    smallest: float  # density
    largest: float
    total: float  # samples of an image
    least: float  # total that `min_counts` need
    most: float  # total that `max_counts` allow
    lowest: float  # largest of `min_counts`
    highest: float  # smallest of `max_counts`
    contradicts: float  # 1 if a pixel has a minimum above its maximum, else 0


def _describe(density: Tensor, total: Tensor, low: Tensor, high: Tensor) -> Float[Tensor, " 8"]:
    """The numbers of a Demand, on the device."""
    sums = (total.amax(), low.sum((1, 2)).amax(), high.sum((1, 2)).amin())
    numbers = (density.amin(), density.amax(), *sums, low.amax(), high.amin(), (low > high).any())
    return torch.stack([number.double() for number in numbers])


def _check_fit(pixels: int, answers: list[float]) -> None:
    """Raise BudgetError as `allocate_counts` does."""
    demand = Demand(*answers)
    if not math.isfinite(demand.smallest) or not math.isfinite(demand.largest):
        raise BudgetError("density has values that are not finite; it must be finite and >= 0")
    if demand.smallest < 0:
        raise BudgetError(
            f"density has negative values, down to {demand.smallest:g}; it must be >= 0"
        )
    if not demand.least <= demand.total <= demand.most or demand.contradicts:
        raise BudgetError(
            f"a budget of {demand.total:.0f} samples for {pixels} pixels does not fit: min_samples "
            f"and earlier passes need {demand.least:.0f}, max_samples and the pool allow "
            f"{demand.most:.0f}"
        )


def _equal_share(demand: Demand, pixels: int) -> int | None:
    """The count of every pixel where density and budget give all the same whole one, else None."""
    share, rest = divmod(int(demand.total), pixels)
    is_even = demand.smallest == demand.largest and not rest
    return share if is_even and demand.lowest <= share <= demand.highest else None


def _fill_first(density: Tensor, total: Tensor, low: Tensor, high: Tensor) -> tuple[Tensor, Tensor]:
    """Density and least counts [n h w], where the pixels that the density names cannot take all.

    Without a positive value the density is uniform. Where all pixels with a positive density will
    be full, they are filled, and the others share the rest evenly.
    """
    positive = density > 0
    has_none = ~positive.flatten(1).any(1)[:, None, None]
    room = torch.where(positive, high, low).sum((1, 2), keepdim=True)
    are_full = ~has_none & (room < total)
    density = torch.where(are_full, (~positive).to(density.dtype), density)
    return density.where(~has_none, 1.0), torch.where(are_full & positive, high, low)


def _water_fill(density: Tensor, total: Tensor, low: Tensor, high: Tensor) -> Tensor:
    """clip(k * density, low, high) with k of each image [h w] such that it sums to `total`.

    The sum is piecewise linear and increases with k; k is found by Newton steps within a bracket.
    The result sums to `total` within 1e-3, or to less if the steps run out.
    """
    low, high = low.double(), high.double()
    asks = may_ask(density)

    def clip(k: Tensor) -> Tensor:
        return torch.minimum(torch.maximum(density * k, low), high)

    k = total / density.sum((1, 2), keepdim=True)
    below, above = torch.zeros_like(k), torch.full_like(k, math.inf)  # bracket of k
    best = torch.zeros_like(k)  # the largest k so far that does not exceed the total
    done = torch.zeros_like(k, dtype=torch.bool)
    for _ in range(MAX_NEWTON_STEPS if asks else UNASKED_NEWTON_STEPS):
        shares = clip(k)
        excess = shares.sum((1, 2), keepdim=True) - total
        fits = (excess <= BUDGET_TOLERANCE) & ~done
        best = torch.where(fits, k, best)
        done = done | (excess.abs() <= BUDGET_TOLERANCE)
        if asks and bool(done.all()):
            break
        below, above = torch.where(fits, k, below), torch.where(fits | done, above, k)
        slope = density.where((shares > low) & (shares < high), 0.0).sum((1, 2), keepdim=True)
        guess = torch.where(slope > 0, k - excess / slope, math.inf)
        halved = torch.where(above == math.inf, 2 * k, (below + above) / 2)
        guess = guess.where((below < guess) & (guess < above), halved)
        k = torch.where(done, k, guess)
    return clip(best)


def _round_shares(shares: Tensor, total: Tensor, high: Tensor, seeds: Tensor) -> Tensor:
    """Whole counts that sum to `total`: each share rounded down or up, at most `high`.

    What the shares lack of the total is first added in proportion to the room below `high`.
    """
    fixed = (shares * ONE_SHARE).long()
    lacking = total * ONE_SHARE - fixed.sum((1, 2), keepdim=True)
    room = high * ONE_SHARE - fixed
    part = lacking.double() / room.sum((1, 2), keepdim=True).clamp_min(1)
    is_far = lacking.abs() >= ONE_SHARE // 2
    fixed = fixed + torch.where(is_far, (room.double() * part).long(), 0)
    return round_to_total(fixed, total, seeds)


def _as_images(value: int | Tensor, like: Tensor) -> Tensor:
    """A number or a tensor [n 1 ...] as one that broadcasts with images [n h w] `like` these."""
    if isinstance(value, int):
        return like.new_full((len(like), 1, 1), value)
    return value[:, 0] if value.ndim > 2 else value[..., None]
