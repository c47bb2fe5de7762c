"""Sample allocation: exact totals, limits, proportionality to the density, and rounding."""

from __future__ import annotations

import math
from fractions import Fraction

import pytest
import torch
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from torch import Tensor

from rlbench.frames import Samples, StoredPool
from rlbench.sampling import BudgetError, allocate_counts, draw_samples

SEEDS = (1,)  # of one image


def image(values: list[float]) -> Tensor:
    """One row of pixels, [1 1 1 w]."""
    return torch.tensor(values, dtype=torch.float32).view(1, 1, 1, -1)


def allocate(density: Tensor, total: int, high: int = 8, seeds: tuple[int, ...] = SEEDS) -> Tensor:
    """Counts of images without a minimum."""
    return allocate_counts(density, total, torch.zeros_like(density).long(), high, seeds)


def allocate_row(
    density: list[float], total: int, low: list[int] | None = None, high: int = 8
) -> list[int]:
    """The counts of one row of pixels."""
    lowest = image(low or [0] * len(density)).long()
    return allocate_counts(image(density), total, lowest, high, SEEDS).flatten().tolist()


DENSITY = st.one_of(
    st.sampled_from([0.0, 1.0, 2.0]),
    st.floats(0, 2.0**100, width=32),
    st.floats(0, 1, width=32),
)


@st.composite
def problems(draw):
    """(density, total, low, high) with a feasible total."""
    density = draw(st.lists(DENSITY, min_size=1, max_size=40))
    high = draw(st.integers(1, 9))
    low = draw(
        st.lists(st.integers(0, high), min_size=len(density), max_size=len(density))
        | st.just([0] * len(density))
    )
    total = draw(st.integers(sum(low), high * len(density)))
    return density, total, low, high


# For every density and feasible budget


@given(problems())
@example(([0.0, 1.0, 2.0**65], 4, [0, 1, 0], 2))  # a contrast beyond the search's doublings
def test_the_sum_is_exact_and_counts_are_within_the_limits(problem):
    density, total, low, high = problem
    counts = allocate_row(density, total, low, high)
    assert sum(counts) == total
    assert all(a <= n <= high for a, n in zip(low, counts, strict=True))


@given(problems(), st.randoms(use_true_random=False))
def test_shuffling_pixels_shuffles_counts_up_to_rounding(problem, draw):
    density, total, low, high = problem
    order = list(range(len(density)))
    draw.shuffle(order)
    shuffled = allocate_row([density[i] for i in order], total, [low[i] for i in order], high)
    counts = allocate_row(density, total, low, high)
    # a count is the share rounded down or up; which pixels are rounded up depends on position
    assert all(abs(shuffled[at] - counts[i]) <= 1 for at, i in enumerate(order))


@given(problems(), st.floats(2**-20, 2**20))
def test_the_scale_of_the_density_does_not_matter(problem, scale):
    density, total, low, high = problem
    scale = 2.0 ** round(math.log2(scale))  # exact in floating point
    density = [d for d in map(float, image(density).flatten())]
    assume(all(d == 0 or 1e-30 < d < 1e30 for d in density))
    scaled = [d * scale for d in density]
    assert allocate_row(scaled, total, low, high) == allocate_row(density, total, low, high)


def exact_shares(density: list[float], total: int, low: list[int], high: int) -> list[Fraction]:
    """The share of each pixel, in exact arithmetic.

    k is found by sorting the values at which a pixel leaves its lower limit or reaches its upper
    limit; between two of them the sum of shares is linear in k.
    """
    exact = [Fraction(d) for d in density]
    if not any(exact):
        exact = [Fraction(1)] * len(exact)
    if sum(high if d else a for d, a in zip(exact, low, strict=True)) < total:
        low = [high if d else a for d, a in zip(exact, low, strict=True)]
        exact = [Fraction(not d) for d in exact]

    def shares(k: Fraction) -> list[Fraction]:
        return [
            min(max(k * d, Fraction(a)), Fraction(high)) for d, a in zip(exact, low, strict=True)
        ]

    corners = sorted(
        {Fraction(b) / d for d, a in zip(exact, low, strict=True) if d for b in (a, high)}
    )
    below, above = Fraction(0), Fraction(0)
    for above in corners:  # noqa: B007  (the first corner at which the sum reaches the total)
        if sum(shares(above)) >= total:
            break
        below = above
    rise = sum(shares(above)) - sum(shares(below))
    k = below + (above - below) * (total - sum(shares(below))) / rise if rise else above
    return shares(k)


@settings(max_examples=200)
@given(problems())
def test_counts_are_exact_shares_rounded_down_or_up(problem):
    density, total, low, high = problem
    values = list(map(float, image(density).flatten()))
    positive = [v for v in values if v]
    # the search for k doubles it at most 64 times
    assume(not positive or max(positive) < 1e15 * min(positive))
    share = exact_shares(values, total, low, high)
    counts = allocate_row(density, total, low, high)
    # the multiplier is found within 1e-3 samples of the budget
    assert all(abs(n - s) < 1 + 2e-3 for n, s in zip(counts, share, strict=True))


@pytest.mark.parametrize(
    ("density", "total", "high"),
    [
        ([0.1, 0.25, 0.7, 1.9, 0.0, 3.3], 11, 4),
        ([1.0, 2.5, 2.75, 8.0], 9, 8),
        ([5.0, 0.3, 0.21, 0.07], 3, 2),
        ([1.0, 1.1, 0.9, 1.2, 0.8], 5, 8),
        ([1e-8, 1.0, 1e8], 13, 8),
    ],
)
def test_the_mean_of_counts_over_seeds_is_the_exact_share(density, total, high):
    values = list(map(float, image(density).flatten()))
    runs = 2000
    counts = allocate(image(density).expand(runs, 1, 1, -1), total, high, tuple(range(runs)))
    mean = counts.double().mean((0, 1, 2))
    exact = [float(s) for s in exact_shares(values, total, [0] * len(values), high)]
    # a count is one of two adjacent integers: standard deviation at most 0.5; 4.5 standard errors
    assert (mean - torch.tensor(exact)).abs().max() < 4.5 * 0.5 / math.sqrt(runs)


# Known answers


KNOWN = {
    "feasible counts are themselves": ([0, 1, 2, 3], 6, {}, [0, 1, 2, 3]),
    "others take what is above the maximum": ([100, 1, 1, 2], 8, {"high": 4}, [4, 1, 1, 2]),
    "pixels of no density take it too": ([1, 1, 0, 0], 6, {"high": 2}, [2, 2, 1, 1]),
    "others pay for the minimum": ([0, 0, 1, 1], 6, {"low": [1] * 4}, [1, 1, 2, 2]),
    "a full budget fills all pixels": ([0, 1, 5], 24, {}, [8, 8, 8]),
    "a budget of zero": ([0, 1, 5], 0, {}, [0, 0, 0]),
    **{f"uniform, {d:g}": ([d] * 6, 12, {}, [2] * 6) for d in (0.0, 1.0, 1e-30, 1e30)},
}


@pytest.mark.parametrize("case", KNOWN)
def test_counts_have_known_answers(case):
    density, total, limits, expected = KNOWN[case]
    assert allocate_row(density, total, **limits) == expected


@pytest.mark.parametrize("value", [math.nan, math.inf, -1.0])
def test_a_negative_or_nonfinite_density_is_an_error(value):
    with pytest.raises(BudgetError, match="finite|negative"):
        allocate_row([1.0, value, 2.0], total=3)


@pytest.mark.parametrize(
    ("total", "low", "high"), [(25, [0, 0, 0], 8), (2, [1, 1, 1], 8), (-1, [0, 0, 0], 8)]
)
def test_an_infeasible_budget_is_an_error(total, low, high):
    with pytest.raises(BudgetError, match=f"a budget of {total} samples for 3 pixels does not fit"):
        allocate_row([1.0, 1.0, 1.0], total, low, high)


# Rounding


@pytest.mark.parametrize("spp", [0.01, 0.5, 1.3])
def test_a_constant_density_gives_quadrants_equal_counts(spp):
    counts = allocate(torch.ones(1, 1, 128, 128), round(spp * 128 * 128))[0, 0]
    sums = counts.unfold(0, 64, 64).unfold(1, 64, 64).sum((-1, -2)).flatten()
    # a quadrant is one segment of the curve: its share of about spp * 4096, rounded down or up
    assert sums.max() - sums.min() <= 1


def test_half_a_sample_per_pixel_is_a_chequerboard():
    counts = allocate(torch.ones(1, 1, 64, 64), 64 * 32)[0, 0]
    odd = (torch.arange(64)[:, None] + torch.arange(64)) % 2
    assert torch.equal(counts, odd) or torch.equal(counts, 1 - odd)


def test_counts_follow_the_density_below_one_sample():
    """Rounding up the largest remainders would give every pixel one sample pool."""
    density = torch.ones(1, 1, 32, 32)
    density[..., :16], density[..., 16:] = 0.7, 1.3
    counts = allocate(density, 32 * 32)
    assert abs(int(counts[..., :16].sum()) - 0.7 * 512) < 3  # a half is two segments of the curve


def test_another_seed_rounds_up_other_pixels_and_the_same_seed_does_not():
    first, again, other = (
        allocate(torch.ones(1, 1, 16, 16), 100, seeds=(seed,)) for seed in (3, 3, 4)
    )
    assert torch.equal(first, again)
    assert not torch.equal(first, other)


def test_a_batch_of_two_is_two_images():
    density = torch.rand(2, 1, 9, 11, generator=torch.Generator().manual_seed(0))
    alone = [allocate(density[i : i + 1], 70, seeds=(5 + i,)) for i in range(2)]
    assert torch.equal(allocate(density, 70, seeds=(5, 6)), torch.cat(alone))


def test_a_budget_of_a_hundredth_sample_per_pixel_is_exact():
    assert int(allocate(torch.rand(1, 1, 720, 720), round(0.01 * 720 * 720)).sum()) == 5184


# Drawing, from a frame of 6 x 7 pixels


def random_pool(slots: int = 8, n: int = 1) -> StoredPool:
    radiance = torch.rand(n, slots, 3, 6, 7, generator=torch.Generator().manual_seed(42))
    return StoredPool(radiance, tuple(range(n)))


def noise(seed: int, n: int = 1) -> Tensor:
    return torch.rand(n, 1, 6, 7, generator=torch.Generator().manual_seed(seed))


def draw(density: Tensor, total_spp: float, pool: StoredPool | None = None) -> Samples:
    pool = pool or random_pool()
    return draw_samples(pool, pool.empty(), density, total_spp)


def draw_after_pilot(
    pool: StoredPool,
    density: Tensor,
    total_spp: float,
    pilot_spp: float = 1.0,
    least: int = 0,
    most: int | None = None,
    pilot_density: Tensor | None = None,
) -> tuple[Samples, Samples]:
    """The pilot, and all samples with it; density and limits apply to those after it."""
    first = noise(0, len(pool.radiance)) if pilot_density is None else pilot_density
    pilot = draw(first, pilot_spp, pool)
    return pilot, draw_samples(pool, pilot, density, total_spp, least, most, discard_pilot=True)


@pytest.mark.parametrize("spp", [0.0, 0.01, 0.5, 1.0, 2.3, 8.0])
def test_drawing_costs_exactly_the_budget(spp):
    assert int(draw(noise(1), spp).counts.sum()) == round(spp * 42)


def test_a_second_pass_keeps_the_samples_of_the_first():
    pool = random_pool()
    first = draw(torch.ones(1, 1, 6, 7), 1.0, pool)
    density = torch.zeros(1, 1, 6, 7)
    density[..., 0] = 1
    second = draw_samples(pool, first, density, total_spp=1.5)
    assert (second.counts >= first.counts).all()
    valid = first.valid_mask.expand_as(first.radiance)
    assert torch.equal(second.radiance[valid], first.radiance[valid])


def test_samples_that_were_not_drawn_are_zero():
    pool = random_pool()
    pool.radiance[:, 1:] = math.nan
    samples = draw(torch.ones(1, 1, 6, 7), 1.0, pool)
    assert torch.equal(samples.radiance[:, 0], pool.radiance[:, 0])
    assert (samples.radiance[:, 1:] == 0).all()


def test_the_mean_is_that_of_the_drawn_samples_and_that_of_none_is_zero():
    pool = random_pool()
    samples = draw(torch.ones(1, 1, 6, 7), 3.0, pool)
    torch.testing.assert_close(samples.mean, pool.radiance[:, :3].mean(1))
    assert (pool.empty().mean == 0).all()


def test_a_density_with_another_shape_is_an_error():
    with pytest.raises(BudgetError, match=r"\[1, 1, 7, 6\], the frame \[1, 1, 6, 7\]"):
        draw(torch.ones(1, 1, 7, 6), 1.0)


def test_no_gradient_flows_through_drawing():
    assert not draw(torch.ones(1, 1, 6, 7, requires_grad=True), 1.0).radiance.requires_grad


def test_samples_since_the_pilot_are_the_next_slots():
    pool = random_pool()
    pilot, samples = draw_after_pilot(pool, noise(1), 3.0)
    later = samples.since(pilot)
    assert torch.equal(later.counts, samples.counts - pilot.counts)
    slot = pilot.counts[:, None].expand(-1, -1, 3, -1, -1)
    first = pool.radiance.gather(1, slot).where(later.counts[:, None] > 0, 0.0)
    assert torch.equal(later.radiance[:, :1], first)
    torch.testing.assert_close(
        later.radiance.sum(1), samples.radiance.sum(1) - pilot.radiance.sum(1)
    )


@pytest.mark.parametrize(("n", "power", "spp"), [(2, 1, 4.0), (1, 4, 7.0), (1, 4, 8.0)])
def test_a_discarded_pilot_counts_towards_the_budget_and_the_size_of_the_pool(n, power, spp):
    _, samples = draw_after_pilot(random_pool(n=n), noise(1, n) ** power, spp)
    assert samples.counts.flatten(1).sum(1).tolist() == [spp * 42] * n
    assert int(samples.counts.max()) <= 8


def test_samples_after_a_discarded_pilot_follow_the_density_alone():
    density = torch.ones(1, 1, 6, 7)
    density[..., :3] = 3
    share = 42 * 4 / int(density.sum())
    pilot, samples = draw_after_pilot(random_pool(slots=16), density, 6.0, pilot_spp=2.0)
    assert ((samples.since(pilot).counts - share * density).abs() < 1).all()


def test_limits_apply_to_samples_after_a_discarded_pilot():
    pilot, samples = draw_after_pilot(random_pool(), noise(1) ** 8, 4.0, least=1, most=5)
    later = samples.since(pilot).counts
    assert (int(later.min()), int(later.max())) == (1, 5)


def test_samples_after_a_discarded_pilot_are_rounded_up_in_other_pixels():
    even = torch.ones(1, 1, 6, 7)
    pilot, samples = draw_after_pilot(random_pool(), even, 1.0, 0.5, pilot_density=even)
    assert not torch.equal(samples.since(pilot).counts, pilot.counts)


def test_an_even_density_is_not_even_where_the_pilot_used_up_the_pool():
    left = torch.ones(1, 1, 6, 7)
    left[..., 3:] = 1e-6
    even = torch.ones(1, 1, 6, 7)
    pilot, samples = draw_after_pilot(random_pool(), even, 5.0, 3.0, pilot_density=left)
    assert int(pilot.counts.max()) == 7  # one is left, and two a pixel are to be drawn
    assert int(samples.counts.max()) <= 8
    assert int(samples.counts.sum()) == 5 * 42
