"""Systematic sampling: proportional to weights and even over the image; the Hilbert curve."""

from __future__ import annotations

import math
from fractions import Fraction

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from rlbench.ops.dither import hash_to_unit_interval, hilbert_order, systematic_sample

CPU = torch.device("cpu")


def curve(order: int) -> list[tuple[int, int]]:
    """The Hilbert curve by its recursive definition: rows and columns of a 2^order square."""
    if order == 0:
        return [(0, 0)]
    half, quarter = 2 ** (order - 1), curve(order - 1)
    first = [(x, y) for y, x in quarter]  # mirrored at the diagonal
    last = [(2 * half - 1 - x, half - 1 - y) for y, x in quarter]  # at the other diagonal
    return [
        *first,
        *((y, half + x) for y, x in quarter),
        *((half + y, half + x) for y, x in quarter),
        *last,
    ]


@pytest.mark.parametrize("order", range(7))
def test_the_curve_equals_its_recursive_definition(order):
    side = 2**order
    pixels = [(int(i) // side, int(i) % side) for i in hilbert_order(side, side, CPU)]
    transposed = [(x, y) for y, x in curve(order)]
    assert pixels in (curve(order), transposed)


@pytest.mark.parametrize(("h", "w"), [(1, 1), (1, 7), (77, 123), (64, 48)])
def test_the_curve_visits_each_pixel_of_an_odd_sized_image_once(h, w):
    assert sorted(hilbert_order(h, w, CPU).tolist()) == list(range(h * w))


def place_marks(weights: list[int], count: int, shift: Fraction) -> list[bool]:
    """Marks `sum / count` apart, one by one; the first is `1 - shift` of that from the start."""
    chosen, ends, total = [False] * len(weights), [], 0
    for w in weights:
        total += w
        ends.append(total)
    for j in range(count):
        at = (j + 1 - shift) * Fraction(total, count)
        chosen[next(i for i, end in enumerate(ends) if end >= at)] = True
    return chosen


@settings(max_examples=50, deadline=None)
@given(st.lists(st.integers(0, 1000), min_size=2, max_size=60), st.data(), st.integers(0, 2**40))
def test_the_sample_equals_marks_placed_one_by_one(values, data, seed):
    values[0] += 1
    count = data.draw(st.integers(1, len(values)))
    weights = torch.tensor(values).view(1, -1)
    order = hilbert_order(1, len(values), CPU)
    along_curve = weights.flatten()[order].tolist()
    chosen = systematic_sample(weights, count, seed).flatten()[order].tolist()
    assert chosen == place_marks(along_curve, count, Fraction(hash_to_unit_interval(seed)))


def sample_density(density: Tensor, count: int, seed: int) -> Tensor:
    return systematic_sample((density * 2**20).long(), count, seed)


def test_each_aligned_square_gets_its_share_rounded_down_or_up():
    y, x = torch.meshgrid(torch.linspace(0, 1, 64), torch.linspace(0, 1, 64), indexing="ij")
    density = (0.05 + 0.9 * (x * y)).double()
    count = round(float(density.sum()))
    chosen = sample_density(density, count, seed=3).double()
    for side in (2, 4, 8, 16, 32):
        shares, counts = (
            v.unfold(0, side, side).unfold(1, side, side).sum((-1, -2)) for v in (density, chosen)
        )
        # a square is one segment of the curve; the sum of densities is within 0.5 of an integer
        assert (counts - shares * count / density.sum()).abs().max() < 1 + 1e-3


def test_the_first_mark_is_uniform():
    """Over many seeds, each of eight equal pixels is chosen equally often."""
    runs = 4000
    hits = torch.stack([systematic_sample(torch.ones(2, 4).long(), 1, s) for s in range(runs)])
    frequency = hits.double().mean(0)
    assert (frequency - 1 / 8).abs().max() < 4.5 * math.sqrt(1 / 8 * 7 / 8 / runs)


def test_a_pixel_of_zero_weight_is_never_chosen():
    weights = torch.tensor([[0, 5, 0, 5, 5, 0]])
    masks = [systematic_sample(weights, 3, seed) for seed in range(50)]
    assert not any(mask[0, [0, 2, 5]].any() for mask in masks)
