"""Dithered rounding: exact sums, no bias, even in every square, and local."""

from __future__ import annotations

import math
from fractions import Fraction

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from rlbench.ops.dither import ONE_SHARE, THRESHOLD_BITS, hash_to_integers, round_to_total


def round_shares(shares: Tensor, seed: int = 0) -> Tensor:
    fixed = (shares.double() * ONE_SHARE).long()
    return round_to_total(fixed[None], round(float(shares.double().sum())), [seed])[0]


@st.composite
def problems(draw):
    """Shares of an image, of any size, and the two totals that they can be rounded to."""
    h, w = draw(st.integers(1, 9)), draw(st.integers(1, 9))
    share = st.one_of(st.integers(0, 3 * ONE_SHARE), st.sampled_from([0, ONE_SHARE, 2 * ONE_SHARE]))
    values = draw(st.lists(share, min_size=h * w, max_size=h * w))
    total = sum(values) // ONE_SHARE + draw(st.integers(0, sum(values) % ONE_SHARE > 0))
    return torch.tensor(values).view(h, w), total, draw(st.integers(0, 2**40))


def hash_to_integer(seed: int, level: int) -> int:
    """The hash in Python's integers, which have no limit."""
    mixed = seed * 64 + level
    for factor in (0x9E3779B97F4A7C15, 0xD1342543DE82EF95):
        mixed = (mixed * factor + 1) & (2**64 - 1)
        mixed ^= mixed >> 32
    return mixed >> (64 - THRESHOLD_BITS)


@given(st.lists(st.integers(0, 2**57 - 1), min_size=1, max_size=3))
def test_thresholds_are_hashes_of_seed_and_level(seeds):
    hashes = hash_to_integers(torch.tensor(seeds), levels=22)
    assert hashes.tolist() == [[hash_to_integer(s, level) for s in seeds] for level in range(22)]


def divide(shares: list[list[Fraction]], total: int, seed: int, level: int) -> list[list[int]]:
    """One level at a time, by recursion and in exact fractions: pair up, round, divide."""
    h, w = len(shares), len(shares[0])
    if h * w == 1:
        return [[total]]
    if w < h:
        transposed = [list(row) for row in zip(*shares, strict=True)]
        return [
            list(row) for row in zip(*divide_rows(transposed, total, seed, level, 1), strict=True)
        ]
    return divide_rows(shares, total, seed, level, 0)


def divide_rows(
    shares: list[list[Fraction]], total: int, seed: int, level: int, transposed: int
) -> list[list[int]]:
    pairs = [
        [(row[i], row[i + 1] if i + 1 < len(row) else Fraction(0)) for i in range(0, len(row), 2)]
        for row in shares
    ]
    sums = [[a + b for a, b in row] for row in pairs]
    if transposed:
        sums = [list(row) for row in zip(*sums, strict=True)]
    counts = divide(sums, total, seed, level + 1)
    if transposed:
        counts = [list(row) for row in zip(*counts, strict=True)]
    result = []
    for y, (row, numbers) in enumerate(zip(pairs, counts, strict=True)):
        line: list[int] = []
        for (first, second), count in zip(row, numbers, strict=True):
            threshold = hash_to_integer(seed, level)
            threshold = 2**THRESHOLD_BITS - 1 - threshold if y % 2 else threshold
            a, b = first % 1, second % 1
            rest = count - int(first) - int(second)
            chance = a / (a + b) if 0 < a + b < 1 else (1 - b) / (2 - a - b) if a + b >= 1 else 0
            up = rest > 1 or (rest == 1 and Fraction(threshold, 2**THRESHOLD_BITS) < chance)
            line += [int(first) + up, count - int(first) - up]
        result.append(line[: len(shares[0])])
    return result


@settings(max_examples=200)
@given(problems())
def test_the_counts_equal_those_of_a_recursive_twin_in_exact_fractions(problem):
    shares, total, seed = problem
    exact = [[Fraction(v, ONE_SHARE) for v in row] for row in shares.tolist()]
    assert round_to_total(shares[None], total, [seed])[0].tolist() == divide(exact, total, seed, 0)


@settings(max_examples=200)
@given(problems())
def test_counts_sum_to_the_total_and_are_shares_rounded_down_or_up(problem):
    shares, total, seed = problem
    counts = round_to_total(shares[None], total, [seed])[0]
    assert int(counts.sum()) == total
    assert (counts >= shares // ONE_SHARE).all()
    assert (counts <= -(-shares // ONE_SHARE)).all()


@pytest.mark.parametrize("seed", range(5))
def test_each_aligned_square_gets_its_share_rounded_down_or_up(seed):
    y, x = torch.meshgrid(torch.linspace(0, 1, 64), torch.linspace(0, 1, 64), indexing="ij")
    shares = (0.05 + 0.9 * (x * y)).double()
    shares *= round(float(shares.sum())) / shares.sum()
    counts = round_shares(shares, seed).double()
    for side in (2, 4, 8, 16, 32):
        share, count = (
            v.unfold(0, side, side).unfold(1, side, side).sum((-1, -2)) for v in (shares, counts)
        )
        assert (count - share).abs().max() < 1


@pytest.mark.parametrize("shape", [(1, 7), (5, 3)])
def test_over_many_seeds_the_mean_count_is_the_share(shape):
    generator = torch.Generator().manual_seed(0)
    shares = torch.rand(shape, generator=generator, dtype=torch.float64)
    shares *= 3 / shares.sum()
    runs = 4000
    mean = torch.stack([round_shares(shares, seed) for seed in range(runs)]).double().mean(0)
    # a count is one of two adjacent integers: standard deviation at most 0.5; 4.5 standard errors
    assert (mean - shares).abs().max() < 4.5 * 0.5 / math.sqrt(runs)


@pytest.mark.parametrize("spp", [0.5, 2.0])
def test_a_change_in_one_pixel_changes_few_counts_of_others(spp):
    """Marks along one curve through the image changed a third of all counts."""
    generator = torch.Generator().manual_seed(0)
    density = torch.rand(128, 128, generator=generator, dtype=torch.float64) + 0.2
    changed = density.clone()
    changed[64, 64] *= 3
    total = spp * density.numel()
    differences = [
        int(
            (
                round_shares(density / density.sum() * total, seed)
                != round_shares(changed / changed.sum() * total, seed)
            ).sum()
        )
        for seed in range(20)
    ]
    assert max(differences) < 0.01 * density.numel()


def test_half_a_share_per_pixel_is_a_chequerboard():
    counts = round_shares(torch.full((16, 16), 0.5))
    odd = (torch.arange(16)[:, None] + torch.arange(16)) % 2
    assert torch.equal(counts, odd) or torch.equal(counts, 1 - odd)
