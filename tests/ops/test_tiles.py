"""Tiles: which ones a change reaches, and windows that cover them, against pixel-wise oracles."""

from __future__ import annotations

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor
from torch.nn import functional as F

from rlbench.ops.tiles import Window, cover_tiles, find_changed_tiles

SIZES = [(1, 1), (40, 72), (64, 64), (65, 31)]


def scattered(h: int, w: int, seed: int, share: float = 0.003, n: int = 1) -> Tensor:
    return torch.rand(n, 1, h, w, generator=torch.Generator().manual_seed(seed)) < share


def dilate(changed: Tensor, radius: int) -> Tensor:
    """True at most `radius` pixels from a changed pixel of any image [h w]."""
    near = F.max_pool2d(changed.any(0).float(), 2 * radius + 1, 1, radius)
    return near[0] > 0


@pytest.mark.parametrize("radius", [0, 1, 17, 200])
@pytest.mark.parametrize(("h", "w"), SIZES)
def test_a_tile_is_changed_if_a_dilated_change_touches_it(h, w, radius):
    changed = scattered(h, w, seed=radius, n=2)
    near = dilate(changed, radius)
    expected = [
        [bool(near[y : y + 32, x : x + 32].any()) for x in range(0, w, 32)] for y in range(0, h, 32)
    ]
    assert find_changed_tiles(changed, radius).tolist() == expected


@given(st.integers(0, 10**6), st.sampled_from(SIZES), st.sampled_from([0, 5, 17]))
@settings(max_examples=30)
def test_windows_cover_every_changed_tile_and_read_no_more_than_tiles_apart(seed, size, radius):
    h, w = size
    tiles = (
        torch.rand(-(-h // 32), -(-w // 32), generator=torch.Generator().manual_seed(seed)) > 0.6
    )
    windows = cover_tiles(tiles, radius, h, w)
    covered = torch.zeros(h, w, dtype=torch.bool)
    for window in windows:
        covered[window.rows, window.columns] = True
        assert (window.rows.start % 32, window.columns.start % 32) == (0, 0)
        assert window.rows.stop in (h, *range(32, h, 32))
        assert window.columns.stop in (w, *range(32, w, 32))
    apart = [
        Window(slice(y * 32, min(y * 32 + 32, h)), slice(x * 32, min(x * 32 + 32, w)))
        for y, x in tiles.nonzero().tolist()
    ]
    assert all(bool(covered[tile.rows, tile.columns].all()) for tile in apart)
    read, read_apart = (sum(each.grow(radius, h, w).area for each in ws) for ws in (windows, apart))
    assert read <= read_apart


def test_no_tile_needs_no_window():
    assert cover_tiles(torch.zeros(3, 4, dtype=torch.bool), 17, 96, 128) == []


def test_a_window_within_a_grown_one_has_the_same_pixels():
    image = torch.arange(60.0 * 70).view(1, 1, 60, 70)
    window = Window(slice(32, 60), slice(32, 64))
    grown = window.grow(9, 60, 70)
    inner = window.relative_to(grown)
    assert torch.equal(inner.crop(grown.crop(image)), image[..., 32:60, 32:64])
