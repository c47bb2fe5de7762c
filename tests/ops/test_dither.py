"""Whole pixels are chosen in proportion to weights, evenly over the image, the same everywhere."""

from __future__ import annotations

import math
from fractions import Fraction

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from rlbench.ops.dither import hilbert_order, hash_to_unit_interval, systematic_sample

CPU = torch.device("cpu")


def curve(order: int) -> list[tuple[int, int]]:
    """The Hilbert curve by its recursive definition: rows and columns of a 2^order square."""
    if order == 0:
        return [(0, 0)]
    half, before = 2 ** (order - 1), curve(order - 1)
    first = [(x, y) for y, x in before]  # turned over the diagonal
    last = [(2 * half - 1 - x, half - 1 - y) for y, x in before]  # over the other one
    return [
        *first,
        *((y, half + x) for y, x in before),
        *((half + y, half + x) for y, x in before),
        *last,
    ]


@pytest.mark.parametrize("order", range(7))
def test_the_curve_is_that_of_its_recursive_definition(order):
    side = 2**order
    found = [(int(i) // side, int(i) % side) for i in hilbert_order(side, side, CPU)]
    turned = [(x, y) for y, x in curve(order)]
    assert found in (curve(order), turned)


@pytest.mark.parametrize(("h", "w"), [(1, 1), (1, 7), (77, 123), (64, 48)])
def test_the_curve_meets_each_pixel_of_an_odd_image_once(h, w):
    assert sorted(hilbert_order(h, w, CPU).tolist()) == list(range(h * w))


def marked(weight: list[int], number: int, shift: Fraction) -> list[bool]:
    """Marks `sum / number` apart, one by one; the first lies `1 - shift` of that from the start."""
    chosen, ends, total = [False] * len(weight), [], 0
    for w in weight:
        total += w
        ends.append(total)
    for j in range(number):
        at = (j + 1 - shift) * Fraction(total, number)
        chosen[next(i for i, end in enumerate(ends) if end >= at)] = True
    return chosen


@settings(max_examples=50, deadline=None)
@given(st.lists(st.integers(0, 1000), min_size=2, max_size=60), st.data(), st.integers(0, 2**40))
def test_it_agrees_with_marks_laid_one_by_one(values, data, key):
    values[0] += 1
    number = data.draw(st.integers(1, len(values)))
    weight = torch.tensor(values).view(1, -1)
    order = hilbert_order(1, len(values), CPU)
    along = weight.flatten()[order].tolist()
    found = systematic_sample(weight, number, key).flatten()[order].tolist()
    assert found == marked(along, number, Fraction(hash_to_unit_interval(key)))


def counted(density: Tensor, number: int, key: int) -> Tensor:
    return systematic_sample((density * 2**20).long(), number, key)


def test_every_square_of_the_image_gets_its_share_rounded_down_or_up():
    y, x = torch.meshgrid(torch.linspace(0, 1, 64), torch.linspace(0, 1, 64), indexing="ij")
    weight = (0.05 + 0.9 * (x * y)).double()
    number = round(float(weight.sum()))
    chosen = counted(weight, number, key=3).double()
    for side in (2, 4, 8, 16, 32):
        wanted, got = (
            v.unfold(0, side, side).unfold(1, side, side).sum((-1, -2)) for v in (weight, chosen)
        )
        # a square is one piece of the curve; the weights' sum is within a half of a whole number
        assert (got - wanted * number / weight.sum()).abs().max() < 1 + 1e-3


def test_the_first_mark_is_anywhere():
    """Over many keys, each of eight equal pixels is the one chosen equally often."""
    keys = 4000
    hits = torch.stack([systematic_sample(torch.ones(2, 4).long(), 1, key) for key in range(keys)])
    share = hits.double().mean(0)
    assert (share - 1 / 8).abs().max() < 4.5 * math.sqrt(1 / 8 * 7 / 8 / keys)


def test_a_pixel_of_no_weight_is_never_chosen():
    weight = torch.tensor([[0, 5, 0, 5, 5, 0]])
    assert all(not systematic_sample(weight, 3, key)[0, [0, 2, 5]].any() for key in range(50))
