"""A budget is spent to the sample, on the pixels that were wished for, and never twice."""

from __future__ import annotations

import math
from fractions import Fraction

import pytest
import torch
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from torch import Tensor

from rlbench.frames import StoredPool
from rlbench.sampling import BudgetError, allocate_counts, draw_samples

KEY = (1,)


def image(values: list[float]) -> Tensor:
    """One row of pixels, [1 1 1 w]."""
    return torch.tensor(values, dtype=torch.float32).view(1, 1, 1, -1)


def at_least(values: list[int]) -> Tensor:
    return torch.tensor(values).view(1, 1, 1, -1)


def spent(
    density: list[float], cost: int, low: list[int] | None = None, high: int = 8
) -> list[int]:
    low = low or [0] * len(density)
    counts = allocate_counts(image(density), cost, at_least(low), high, KEY)
    return counts.flatten().tolist()


DENSITY = st.one_of(
    st.sampled_from([0.0, 1.0, 2.0]),
    st.floats(0, 2.0**100, width=32),
    st.floats(0, 1, width=32),
)


@st.composite
def wishes(draw):
    """(density, cost, low, high) that can be met."""
    density = draw(st.lists(DENSITY, min_size=1, max_size=40))
    high = draw(st.integers(1, 9))
    low = draw(
        st.lists(st.integers(0, high), min_size=len(density), max_size=len(density))
        | st.just([0] * len(density))
    )
    cost = draw(st.integers(sum(low), high * len(density)))
    return density, cost, low, high


# For every density and budget that fit


@settings(deadline=None)
@given(wishes())
def test_the_sum_is_exact(wish):
    density, cost, low, high = wish
    assert sum(spent(density, cost, low, high)) == cost


@settings(deadline=None)
@given(wishes())
def test_floor_and_cap_hold(wish):
    density, cost, low, high = wish
    assert all(a <= n <= high for a, n in zip(low, spent(density, cost, low, high), strict=True))


@settings(deadline=None)
@given(wishes(), st.randoms(use_true_random=False))
def test_counts_move_with_their_pixels_up_to_rounding(wish, draw):
    density, cost, low, high = wish
    order = list(range(len(density)))
    draw.shuffle(order)
    moved = spent([density[i] for i in order], cost, [low[i] for i in order], high)
    counts = spent(density, cost, low, high)
    # each is its share rounded down or up, and who is rounded up depends on the place
    assert all(abs(moved[at] - counts[i]) <= 1 for at, i in enumerate(order))


@settings(deadline=None)
@given(wishes(), st.floats(2**-20, 2**20))
def test_scale_does_not_matter(wish, scale):
    density, cost, low, high = wish
    scale = 2.0 ** round(math.log2(scale))  # exact in floating point
    density = [d for d in map(float, image(density).flatten())]
    assume(all(d == 0 or 1e-30 < d < 1e30 for d in density))
    scaled = [d * scale for d in density]
    assert spent(scaled, cost, low, high) == spent(density, cost, low, high)


def exact_shares(density: list[float], cost: int, low: list[int], high: int) -> list[Fraction]:
    """The share of each pixel, in exact arithmetic.

    k is found by sorting the values at which a pixel leaves its floor or reaches its cap; between
    two of them the sum is a straight line.
    """
    wish = [Fraction(d) for d in density]
    if not any(wish):
        wish = [Fraction(1)] * len(wish)
    if sum(high if d else a for d, a in zip(wish, low, strict=True)) < cost:
        low = [high if d else a for d, a in zip(wish, low, strict=True)]
        wish = [Fraction(not d) for d in wish]

    def shares(k: Fraction) -> list[Fraction]:
        return [
            min(max(k * d, Fraction(a)), Fraction(high)) for d, a in zip(wish, low, strict=True)
        ]

    corners = sorted(
        {Fraction(b) / d for d, a in zip(wish, low, strict=True) if d for b in (a, high)}
    )
    below, above = Fraction(0), Fraction(0)
    for above in corners:  # noqa: B007  (the first corner at which the sum reaches the cost)
        if sum(shares(above)) >= cost:
            break
        below = above
    rise = sum(shares(above)) - sum(shares(below))
    k = below + (above - below) * (cost - sum(shares(below))) / rise if rise else above
    return shares(k)


@settings(max_examples=200, deadline=None)
@given(wishes())
def test_a_count_is_the_exact_share_rounded_down_or_up(wish):
    density, cost, low, high = wish
    values = list(map(float, image(density).flatten()))
    wanted = [v for v in values if v]
    assume(not wanted or max(wanted) < 1e15 * min(wanted))  # the search for k doubles it 64 times
    share = exact_shares(values, cost, low, high)
    counts = spent(density, cost, low, high)
    # the multiplier is found within 1e-3 samples of the budget
    assert all(abs(n - s) < 1 + 2e-3 for n, s in zip(counts, share, strict=True))


@pytest.mark.parametrize(
    ("density", "cost", "high"),
    [
        ([0.1, 0.25, 0.7, 1.9, 0.0, 3.3], 11, 4),
        ([1.0, 2.5, 2.75, 8.0], 9, 8),
        ([5.0, 0.3, 0.21, 0.07], 3, 2),
        ([1.0, 1.1, 0.9, 1.2, 0.8], 5, 8),
        ([1e-8, 1.0, 1e8], 13, 8),
    ],
)
def test_the_mean_of_counts_over_keys_is_the_exact_share(density, cost, high):
    values = list(map(float, image(density).flatten()))
    keys, low = 2000, torch.zeros(2000, 1, 1, len(values), dtype=torch.int64)
    counts = allocate_counts(image(density).expand(low.shape), cost, low, high, tuple(range(keys)))
    mean = counts.double().mean((0, 1, 2))
    exact = [float(s) for s in exact_shares(values, cost, [0] * len(values), high)]
    # a count is one of two neighbours, so its deviation is at most 0.5; 4.5 standard errors
    assert (mean - torch.tensor(exact)).abs().max() < 4.5 * 0.5 / math.sqrt(keys)


# Known answers


def test_a_density_of_whole_numbers_is_met_as_it_is():
    assert spent([0, 1, 2, 3], cost=6) == [0, 1, 2, 3]


def test_what_the_cap_cuts_goes_to_the_others():
    assert spent([100, 1, 1, 2], cost=8, high=4) == [4, 1, 1, 2]


def test_a_pixel_that_nobody_wants_takes_what_full_pixels_cannot():
    assert spent([1, 1, 0, 0], cost=6, high=2) == [2, 2, 1, 1]


def test_a_floor_is_paid_from_the_others_share():
    assert spent([0, 0, 1, 1], cost=6, low=[1, 1, 1, 1]) == [1, 1, 2, 2]


@pytest.mark.parametrize("value", [0.0, 1.0, 1e-30, 1e30])
def test_a_constant_or_empty_wish_is_uniform(value):
    assert spent([value] * 6, cost=12) == [2] * 6


def test_a_full_budget_fills_all():
    assert spent([0, 1, 5], cost=24) == [8, 8, 8]


def test_no_budget_buys_nothing():
    assert spent([0, 1, 5], cost=0) == [0, 0, 0]


@pytest.mark.parametrize("value", [math.nan, math.inf, -1.0])
def test_a_wish_that_is_no_density_is_an_error(value):
    with pytest.raises(BudgetError, match="finite|negative"):
        spent([1.0, value, 2.0], cost=3)


@pytest.mark.parametrize(
    ("cost", "low", "high"), [(25, [0, 0, 0], 8), (2, [1, 1, 1], 8), (-1, [0, 0, 0], 8)]
)
def test_a_budget_that_does_not_fit_is_an_error(cost, low, high):
    with pytest.raises(BudgetError, match=f"a budget of {cost} samples for 3 pixels does not fit"):
        spent([1.0, 1.0, 1.0], cost, low, high)


# What is left after rounding down


@pytest.mark.parametrize("spp", [0.01, 0.5, 1.3])
def test_a_constant_density_favours_no_quadrant(spp):
    side, zero = 128, torch.zeros(1, 1, 128, 128, dtype=torch.int64)
    counts = allocate_counts(torch.ones(1, 1, side, side), round(spp * side * side), zero, 8, KEY)[
        0, 0
    ]
    mass = counts.unfold(0, 64, 64).unfold(1, 64, 64).sum((-1, -2)).flatten()
    # a quadrant is one piece of the curve: its share of about spp * 4096, rounded down or up
    assert mass.max() - mass.min() <= 1


def test_half_a_sample_everywhere_is_a_chequerboard():
    zero = torch.zeros(1, 1, 64, 64, dtype=torch.int64)
    counts = allocate_counts(torch.ones(1, 1, 64, 64), 64 * 32, zero, 8, KEY)[0, 0]
    odd = (torch.arange(64)[:, None] + torch.arange(64)) % 2
    assert torch.equal(counts, odd) or torch.equal(counts, 1 - odd)


def test_density_is_followed_below_one_sample_too():
    """Where the largest remainders were served first, all pixels got one sample here."""
    wish = torch.ones(1, 1, 32, 32)
    wish[..., :16], wish[..., 16:] = 0.7, 1.3
    counts = allocate_counts(wish, 32 * 32, torch.zeros(1, 1, 32, 32, dtype=torch.int64), 8, KEY)
    assert abs(int(counts[..., :16].sum()) - 0.7 * 512) < 3  # the half is two pieces of the curve


def test_another_key_rounds_others_up_and_the_same_key_does_not():
    zero, wish = torch.zeros(1, 1, 16, 16, dtype=torch.int64), torch.ones(1, 1, 16, 16)
    first, again, other = (allocate_counts(wish, 100, zero, 8, (k,)) for k in (3, 3, 4))
    assert torch.equal(first, again)
    assert not torch.equal(first, other)


def test_a_batch_of_two_is_two_images():
    wish = torch.rand(2, 1, 9, 11, generator=torch.Generator().manual_seed(0))
    zero = torch.zeros(2, 1, 9, 11, dtype=torch.int64)
    both = allocate_counts(wish, 70, zero, 8, (5, 6))
    alone = [allocate_counts(wish[i : i + 1], 70, zero[i : i + 1], 8, (5 + i,)) for i in range(2)]
    assert torch.equal(both, torch.cat(alone))


# Buying


def pool(h: int = 6, w: int = 7, stored: int = 8, n: int = 1) -> StoredPool:
    generator = torch.Generator().manual_seed(h * w)
    return StoredPool(torch.rand(n, stored, 3, h, w, generator=generator), tuple(range(n)))


def test_a_hundredth_of_a_sample_per_pixel_is_paid_to_the_sample():
    full = StoredPool(torch.zeros(1, 8, 1, 720, 720), KEY)  # one channel is enough to count
    counts = allocate_counts(
        torch.rand(1, 1, 720, 720), round(0.01 * 720 * 720), full.empty().counts, 8, KEY
    )
    assert int(counts.sum()) == 5184


@pytest.mark.parametrize("spp", [0.0, 0.01, 0.5, 1.0, 2.3, 8.0])
def test_buying_costs_the_budget(spp):
    here = pool()
    wish = torch.rand(1, 1, 6, 7, generator=torch.Generator().manual_seed(1))
    assert int(draw_samples(here, here.empty(), wish, target_spp=spp).counts.sum()) == round(
        spp * 42
    )


def test_a_second_pass_keeps_what_the_first_bought():
    here = pool()
    first = draw_samples(here(here), torch.ones(1, 1, 6, 7), target_spp=1)
    wish = torch.zeros(1, 1, 6, 7)
    wish[..., 0] = 1
    second = draw_samples(here, first, wish, target_spp=1.5)
    assert (second.counts >= first.counts).all()
    kept = first.valid_mask.expand_as(first.radiance)
    assert torch.equal(second.radiance[kept], first.radiance[kept])


def test_what_was_not_bought_is_not_there():
    values = pool().radiance.clone()
    values[:, 1:] = math.nan
    samples = draw_samples(
        StoredPool(values, KEY), pool().empty(), torch.ones(1, 1, 6, 7), target_spp=1
    )
    assert torch.equal(samples.radiance[:, 0], values[:, 0])
    assert (samples.radiance[:, 1:] == 0).all()


def test_the_mean_is_that_of_the_bought():
    here = pool()
    samples = draw_samples(here(here), torch.ones(1, 1, 6, 7), target_spp=3)
    torch.testing.assert_close(samples.mean, here.radiance[:, :3].mean(1))


def test_the_mean_of_nothing_is_zero():
    assert (pool().empty().mean == 0).all()


def test_a_floor_of_one_samples_every_pixel():
    here = pool()
    wish = torch.zeros(1, 1, 6, 7)
    wish[..., 2, 2] = 1
    assert (
        int(draw_samples(here, here.empty(), wish, target_spp=1.2, min_samples=1).counts.min()) == 1
    )


def test_a_floor_beyond_the_budget_is_an_error():
    here = pool()
    with pytest.raises(BudgetError, match="does not fit"):
        draw_samples(here(here), torch.ones(1, 1, 6, 7), target_spp=0.5, min_samples=1)


def test_a_density_of_another_shape_is_an_error():
    here = pool()
    with pytest.raises(BudgetError, match=r"\[1, 1, 7, 6\], the frame \[1, 1, 6, 7\]"):
        draw_samples(here(here), torch.ones(1, 1, 7, 6), target_spp=1)


def test_no_gradient_flows_through_buying():
    here = pool()
    wish = torch.ones(1, 1, 6, 7, requires_grad=True)
    assert not draw_samples(here, here.empty(), wish, target_spp=1).radiance.requires_grad


def stored(slots: int = 8, h: int = 6, w: int = 7, n: int = 1) -> StoredPool:
    """A pool whose sample in slot k has radiance k + 1."""
    radiance = torch.arange(1.0, slots + 1).view(1, -1, 1, 1, 1).expand(n, -1, 3, h, w)
    return StoredPool(radiance, tuple(range(n)))


def noise(seed: int, n: int = 1, h: int = 6, w: int = 7) -> Tensor:
    return torch.rand(n, 1, h, w, generator=torch.Generator().manual_seed(seed))


def test_fresh_samples_are_those_that_follow_the_pilots():
    pool = stored()
    pilot = draw_samples(pool(pool), noise(0), 1.0)
    bought = draw_samples(pool, pilot, noise(1), 3.0, discard_pilot=True)
    fresh = bought.since(pilot)
    assert torch.equal(fresh.counts, bought.counts - pilot.counts)
    first = (pilot.counts + 1).where(fresh.counts > 0, 0)[:, None].expand(-1, -1, 3, -1, -1)
    assert torch.equal(fresh.radiance[:, :1], first.float())
    assert torch.equal(fresh.radiance.sum(1), bought.radiance.sum(1) - pilot.radiance.sum(1))


def test_a_pilot_is_paid_for_when_fresh_samples_are_bought():
    pool = stored(n=2)
    pilot = draw_samples(pool(pool), noise(0, n=2), 1.5)
    bought = draw_samples(pool, pilot, noise(1, n=2), 4.0, discard_pilot=True)
    assert bought.counts.flatten(1).sum(1).tolist() == [4 * 42, 4 * 42]


def test_fresh_samples_follow_the_density_whatever_the_pilot_had():
    pool = stored(slots=16)
    pilot = draw_samples(pool(pool), noise(0), 2.0)
    wish = torch.ones(1, 1, 6, 7)
    wish[..., :3] = 3
    share = 42 * 4 / int(wish.sum())
    bought = draw_samples(pool, pilot, wish, 6.0, discard_pilot=True).since(pilot)
    assert ((bought.counts - share * wish).abs() < 1).all()


def test_a_floor_holds_for_fresh_samples():
    pool = stored()
    pilot = draw_samples(pool(pool), noise(0), 1.0)
    bought = draw_samples(pool, pilot, noise(1) ** 8, 4.0, min_samples=1, discard_pilot=True).since(
        pilot
    )
    assert int(bought.counts.min()) == 1


@pytest.mark.parametrize("upto", [7.0, 8.0])
def test_pilot_and_fresh_samples_share_the_cap(upto):
    pool = stored()
    pilot = draw_samples(pool(pool), noise(0), 1.0)
    bought = draw_samples(pool, pilot, noise(1) ** 4, upto, discard_pilot=True)
    assert int(bought.counts.max()) == 8
    assert int(bought.counts.sum()) == upto * 42
