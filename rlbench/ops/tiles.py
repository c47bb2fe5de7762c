"""Tiles of an image: which of them a change reaches, and the windows that hold these."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import groupby
from typing import NamedTuple

import torch
from jaxtyping import Bool
from torch import Tensor
from torch.nn import functional as F

__all__ = ["TILE_SIDE", "Window", "cover_tiles", "find_changed_tiles"]

TILE_SIDE = 32  # pixels


class Window(NamedTuple):
    """A rectangle of pixels."""

    rows: slice
    columns: slice

    @property
    def area(self) -> int:
        """Number of pixels."""
        height, width = (side.stop - side.start for side in self)
        return int(height * width)

    def grow(self, radius: int, h: int, w: int) -> Window:
        """The window and all pixels at most `radius` away that an image of h x w pixels has.

        >>> Window(slice(0, 32), slice(32, 64)).grow(8, h=40, w=100)
        Window(rows=slice(0, 40, None), columns=slice(24, 72, None))
        """
        sides = zip((self.rows, self.columns), (h, w), strict=True)
        return Window(
            *(slice(max(s.start - radius, 0), min(s.stop + radius, length)) for s, length in sides)
        )

    def join(self, other: Window) -> Window:
        """The smallest window that holds both."""
        pairs = zip(self, other, strict=True)
        return Window(*(slice(min(a.start, b.start), max(a.stop, b.stop)) for a, b in pairs))

    def relative_to(self, outer: Window) -> Window:
        """This window in the coordinates of another one that contains it."""
        pairs = zip(self, outer, strict=True)
        return Window(*(slice(s.start - o.start, s.stop - o.start) for s, o in pairs))

    def crop(self, image: Tensor) -> Tensor:
        """The pixels of the window, contiguous; `image` ends in the dimensions h and w."""
        return image[..., self.rows, self.columns].contiguous()


def find_changed_tiles(
    changed: Bool[Tensor, "n 1 h w"], radius: int, side: int = TILE_SIDE
) -> Bool[Tensor, "rows columns"]:
    """True for tiles that have a changed pixel, in any image, inside or at most `radius` away.

    Tiles have `side` x `side` pixels; the last row and column may have fewer. Counts changed pixels
    by a summed-area table (Crow 1984).

    >>> changed = torch.zeros(1, 1, 64, 96, dtype=torch.bool)
    >>> changed[0, 0, 30, 40] = True
    >>> find_changed_tiles(changed, radius=2).int().tolist()
    [[0, 1, 0], [0, 1, 0]]
    """
    h, w = changed.shape[-2:]
    table = F.pad(changed.any(0)[0].long().cumsum(0).cumsum(1), (1, 0, 1, 0))
    top, bottom = _reach(h, radius, side, table.device)
    left, right = _reach(w, radius, side, table.device)
    below, above = table[bottom], table[top]
    return (below[:, right] - below[:, left] - above[:, right] + above[:, left]) > 0


def cover_tiles(
    tiles: Bool[Tensor, "rows columns"], radius: int, h: int, w: int, side: int = TILE_SIDE
) -> list[Window]:
    """Windows of whole tiles that cover all tiles that are True, in an image of h x w pixels.

    Runs of tiles are joined, one after the other, where a common window that is grown by `radius`
    has at most the pixels of the two grown apart. So windows may hold other tiles too, and overlap.

    >>> cover_tiles(torch.tensor([[True, False], [True, False]]), radius=8, h=64, w=64)
    [Window(rows=slice(0, 64, None), columns=slice(0, 32, None))]
    """
    windows: list[Window] = []

    def read_area(window: Window) -> int:
        return window.grow(radius, h, w).area

    for run in _find_runs(tiles, h, w, side):
        for index, window in enumerate(windows):
            joined = window.join(run)
            if read_area(joined) <= read_area(window) + read_area(run):
                windows[index] = joined
                break
        else:
            windows.append(run)
    return windows


def _reach(length: int, radius: int, side: int, device: torch.device) -> tuple[Tensor, Tensor]:
    """First and one past the last pixel that each tile along an axis depends on."""
    start = torch.arange(0, length, side, device=device)
    return (start - radius).clamp_min(0), (start + side + radius).clamp_max(length)


def _find_runs(tiles: Tensor, h: int, w: int, side: int) -> Iterator[Window]:
    """The windows of tiles side by side that are True, row by row."""
    for row, line in enumerate(tiles.tolist()):
        rows = slice(row * side, min((row + 1) * side, h))
        for is_run, group in groupby(range(len(line)), key=line.__getitem__):
            first, *rest = group
            if is_run:
                yield Window(rows, slice(first * side, min((first + len(rest) + 1) * side, w)))
