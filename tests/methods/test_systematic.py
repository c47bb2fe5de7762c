"""Systematic rounding of the gradient study: the curve, and marks placed one by one."""

from __future__ import annotations

import pytest
import torch

from methods.ours.experiments.gradients.systematic import hilbert_order, round_systematically


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
    pixels = [(int(i) // side, int(i) % side) for i in hilbert_order(side, side)]
    transposed = [(x, y) for y, x in curve(order)]
    assert pixels in (curve(order), transposed)


@pytest.mark.parametrize(("h", "w"), [(1, 1), (1, 7), (77, 123), (64, 48)])
def test_the_curve_visits_each_pixel_of_an_odd_sized_image_once(h, w):
    assert sorted(hilbert_order(h, w).tolist()) == list(range(h * w))


@pytest.mark.parametrize("offset", [0.0, 0.25, 0.6, 0.99])
def test_the_counts_equal_marks_placed_one_by_one(offset):
    generator = torch.Generator().manual_seed(0)
    shares = 3 * torch.rand(1, 5, 7, generator=generator, dtype=torch.float64)
    shares *= round(float(shares.sum())) / shares.sum()
    counts, end = shares.floor().flatten(), 0.0
    for pixel in hilbert_order(5, 7).tolist():
        before, end = end, end + float(shares.flatten()[pixel] % 1)
        counts[pixel] += int(end + offset + 1e-9) - int(before + offset + 1e-9)
    rounded = round_systematically(shares, torch.tensor([offset], dtype=torch.float64))
    assert torch.equal(rounded.flatten(), counts)
    assert rounded.sum() == shares.sum().round()
