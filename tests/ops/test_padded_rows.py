"""Images in a row: what is laid comes back, and neighbours are where they should be."""

from __future__ import annotations

import pytest
import torch

from rlbench.ops import padded_rows as module
from rlbench.ops.padded_rows import PaddedRows
from rlbench.ops.stencils import atrous_taps, box

SIZES = [(1, 1, 1, 3), (1, 5, 7, 3), (2, 4, 6, 5), (3, 9, 2, 8)]
every_size = pytest.mark.parametrize("size", SIZES, ids=str)


def numbered(flat: PaddedRows) -> torch.Tensor:
    """Images whose pixels are 1, 2, 3 and so on."""
    count = flat.n * flat.h * flat.w
    return torch.arange(1.0, count + 1).view(flat.n, 1, flat.h, flat.w)


@every_size
def test_what_is_laid_can_be_lifted(size):
    flat = PaddedRows(*size)
    images = torch.cat((numbered(flat), -numbered(flat)), 1)
    assert torch.equal(flat.unpack(flat.pack(images)), images)


@every_size
def test_margins_hold_what_was_asked_for(size):
    flat = PaddedRows(*size)
    row = flat.pack(numbered(flat), empty=-7.0)
    assert int((row != -7).sum()) == flat.n * flat.h * flat.w


@every_size
def test_every_neighbour_within_the_margin_is_a_fixed_distance_away(size):
    flat = PaddedRows(*size)
    row, m = flat.pack(numbered(flat)), flat.margin
    wide = torch.nn.functional.pad(numbered(flat), (m, m, m, m))
    for down in range(-m, m + 1):
        for right in range(-m, m + 1):
            moved = wide[:, :, m + down : m + down + flat.h, m + right : m + right + flat.w]
            there = torch.roll(row, -flat.offset(down, right), 1)
            assert torch.equal(flat.unpack(there), moved)


@every_size
def test_positions_lead_to_their_pixels_and_outside_to_nothing(size):
    flat = PaddedRows(*size)
    row, images = flat.pack(numbered(flat))[0], numbered(flat)[:, 0]
    for y in range(-9, flat.h + 9):
        for x in range(-9, flat.w + 9):
            there = torch.full((flat.n, 1, 1), float(x)), torch.full((flat.n, 1, 1), float(y))
            found = row[flat.places(*there)][:, 0, 0]
            inside = 0 <= y < flat.h and 0 <= x < flat.w
            assert torch.equal(found, images[:, y, x] if inside else torch.zeros(flat.n))


@every_size
@pytest.mark.parametrize("piece", [1, 10, 1000])
def test_pieces_hold_every_pixel_once_and_can_look_ahead(size, piece, monkeypatch):
    monkeypatch.setattr(module, "PIECE", piece)
    flat = PaddedRows(*size)
    row = flat.pack(numbered(flat))
    seen = torch.zeros_like(row)
    for start, stop in flat.pieces(row):
        seen[:, start:stop] += 1
        assert stop + flat.offset(flat.margin, flat.margin) <= row.shape[1]
    assert (seen[row > 0] == 1).all()
    assert seen.max() == 1


@pytest.mark.parametrize(
    ("taps", "count"), [(box(3), 49), (box(1), 9), (atrous_taps(1), 25), (atrous_taps(8), 25)]
)
def test_taps_and_their_opposites_and_the_centre_are_the_whole_kernel(taps, count):
    both = {(t.down, t.right) for t in taps} | {(-t.down, -t.right) for t in taps} | {(0, 0)}
    assert len(both) == count == 2 * len(taps) + 1


def test_the_spline_sums_to_one_over_its_centre():
    assert 1 + 2 * sum(tap.weight for tap in atrous_taps(4)) == pytest.approx(64 / 9)


def test_the_spline_is_the_square_of_1_4_6_4_1():
    corner = next(tap for tap in atrous_taps(2) if (tap.down, tap.right) == (4, -4))
    assert corner.weight == pytest.approx((1 / 16) ** 2 / (6 / 16) ** 2)
