"""Padding; rows with margins, neighbours at fixed offsets, chunks; and filter stencils."""

from __future__ import annotations

import pytest
import torch

from rlbench.ops import padded_rows
from rlbench.ops.padded_rows import PaddedRows, read_windows
from rlbench.ops.padding import crop, pad
from rlbench.ops.stencils import atrous_stencil, box_stencil

SIZES = [(1, 1, 1, 3), (1, 5, 7, 3), (2, 4, 6, 5), (3, 9, 2, 8)]
every_size = pytest.mark.parametrize("size", SIZES, ids=str)


def numbered_images(rows: PaddedRows) -> torch.Tensor:
    """Images whose pixels are 1, 2, 3 and so on."""
    count = rows.n * rows.h * rows.w
    return torch.arange(1.0, count + 1).view(rows.n, 1, rows.h, rows.w)


@every_size
def test_margins_hold_the_fill_value(size):
    rows = PaddedRows(*size)
    row = rows.pack(numbered_images(rows), -7.0)
    assert int((row != -7).sum()) == rows.n * rows.h * rows.w


@every_size
def test_neighbours_within_the_margin_are_at_fixed_offsets(size):
    rows = PaddedRows(*size)
    row, m = rows.pack(numbered_images(rows)), rows.margin
    wide = torch.nn.functional.pad(numbered_images(rows), (m, m, m, m))
    for down in range(-m, m + 1):
        for right in range(-m, m + 1):
            shifted = wide[:, :, m + down : m + down + rows.h, m + right : m + right + rows.w]
            rolled = torch.roll(row, -rows.offset(down, right), 1)
            assert torch.equal(rows.unpack(rolled), shifted)


@every_size
def test_indices_point_to_pixels_or_outside_to_empty_elements(size):
    rows = PaddedRows(*size)
    row, images = rows.pack(numbered_images(rows))[0], numbered_images(rows)[:, 0]
    for y in range(-9, rows.h + 9):
        for x in range(-9, rows.w + 9):
            position = (torch.full((rows.n, 1, 1), float(value)) for value in (x, y))
            values = row[rows.pixel_index(*position)][:, 0, 0]
            inside = 0 <= y < rows.h and 0 <= x < rows.w
            assert torch.equal(values, images[:, y, x] if inside else torch.zeros(rows.n))


@every_size
@pytest.mark.parametrize("chunk", [1, 10, 1000])
def test_chunks_cover_every_pixel_once_within_the_margin(size, chunk, monkeypatch):
    monkeypatch.setattr(padded_rows, "CHUNK_PIXELS", chunk)
    rows = PaddedRows(*size)
    row = rows.pack(numbered_images(rows))
    visits = torch.zeros_like(row)
    for start, stop in rows.chunks(row):
        visits[:, start:stop] += 1
        assert stop + rows.offset(rows.margin, rows.margin) <= row.shape[1]
    assert (visits[row > 0] == 1).all()
    assert visits.max() == 1


@pytest.mark.parametrize(
    ("stencil", "count"),
    [(box_stencil(3), 49), (box_stencil(1), 9), (atrous_stencil(1), 25), (atrous_stencil(8), 25)],
)
def test_taps_their_opposites_and_the_centre_make_the_whole_kernel(stencil, count):
    taps = stencil.taps
    offsets = {(t.down, t.right) for t in taps} | {(-t.down, -t.right) for t in taps} | {(0, 0)}
    assert len(offsets) == count == 2 * len(taps) + 1


def test_the_spline_is_the_square_of_1_4_6_4_1():
    assert 1 + 2 * sum(tap.weight for tap in atrous_stencil(4).taps) == pytest.approx(64 / 9)
    corner = next(tap for tap in atrous_stencil(2).taps if (tap.down, tap.right) == (4, -4))
    assert corner.weight == pytest.approx((1 / 16) ** 2 / (6 / 16) ** 2)


@pytest.mark.parametrize(
    ("size", "padded_size"),
    [((16, 32), (16, 32)), ((1, 1), (16, 16)), ((17, 31), (32, 32)), ((5, 48), (16, 48))],
)
def test_padded_sides_are_the_next_multiples_and_cropping_undoes_padding(size, padded_size):
    image = torch.rand(2, 3, *size)
    padded = pad(image, 16)
    assert padded.shape[-2:] == padded_size
    assert torch.equal(crop(padded, *size), image)


def test_padding_replicates_the_border():
    padded = pad(torch.arange(6.0).view(1, 1, 2, 3), 4)
    expected = torch.tensor([[0.0, 1, 2, 2], [3, 4, 5, 5], [3, 4, 5, 5], [3, 4, 5, 5]])
    assert torch.equal(padded[0, 0], expected)


@pytest.mark.parametrize("stencil", [box_stencil(2), atrous_stencil(1), atrous_stencil(3)])
def test_squares_have_the_weight_and_distance_of_each_tap(stencil):
    weight, distance = stencil.squares(torch.zeros(1, dtype=torch.float64))
    for tap in stencil.taps:
        for sign in (1, -1):
            y, x = (stencil.reach + sign * each // stencil.step for each in tap[:2])
            assert weight[y, x].item() == pytest.approx(tap.weight)
            assert distance[y, x].item() == pytest.approx((tap.down**2 + tap.right**2) ** 0.5)


@every_size
def test_windows_are_the_neighbours(size):
    rows = PaddedRows(*size)
    row, stencil = rows.pack(numbered_images(rows)), atrous_stencil(max(1, rows.margin // 2))
    windows = read_windows(row, rows.pitch, stencil.reach, stencil.step)
    pixels = row[0].nonzero()[:, 0]
    for tap in stencil.taps:
        if max(tap.down, abs(tap.right)) <= rows.margin:
            y, x = (stencil.reach + each // stencil.step for each in tap[:2])
            expected = row[0, pixels + rows.offset(tap.down, tap.right)]
            assert torch.equal(windows[0, y, x, pixels], expected)
