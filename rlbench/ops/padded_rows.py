"""Images stored as one row with margins, so that each neighbour is a fixed distance away."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn import functional as F

__all__ = ["PaddedRows", "read_windows"]

CHUNK_PIXELS = 1 << 16  # pixels per chunk on a CPU: they fit its cache and occupy two threads


@dataclass(frozen=True)
class PaddedRows:
    """The layout of n images of h x w pixels in one row, with `margin` empty pixels around each.

    Each line ends in `margin` empty pixels, and `margin` empty lines precede and follow each image.
    A neighbour up to `margin` pixels away, down or across, is then either a pixel of the same image
    or empty, and lies `offset(down, right)` elements further along the row. Filters with many taps
    run along slices of the row, without border tests and with contiguous memory access.

    >>> rows = PaddedRows(n=1, h=2, w=3, margin=1)
    >>> row = rows.pack(torch.arange(1.0, 7.0).view(1, 1, 2, 3))
    >>> row[0].tolist()
    [0.0, 0.0, 0.0, 0.0, 1.0, 2.0, 3.0, 0.0, 4.0, 5.0, 6.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    >>> rows.offset(down=1, right=-1)  # from 3.0 to 5.0
    3
    """

    n: int
    h: int
    w: int
    margin: int  # pixels

    @property
    def pitch(self) -> int:
        """Elements from a pixel to the one below."""
        return self.w + self.margin

    def offset(self, down: int, right: int) -> int:
        """Elements from a pixel to another that is at most `margin` pixels away."""
        return down * self.pitch + right

    def pack(self, image: Float[Tensor, "n c h w"], fill: float = 0.0) -> Float[Tensor, "c row"]:
        """Pack the images into a row, with a constant (the second argument) in the margins."""
        m = self.margin
        return F.pad(image, (0, m, m, m), value=fill).transpose(0, 1).reshape(image.shape[1], -1)

    def unpack(self, row: Float[Tensor, "c row"]) -> Float[Tensor, "n c h w"]:
        """Unpack the images from a row; undoes `pack`."""
        images = row.view(row.shape[0], self.n, -1, self.pitch).transpose(0, 1)
        return images[:, :, self.margin : self.margin + self.h, : self.w]

    def pixel_index(
        self, x: Float[Tensor, "n h w"], y: Float[Tensor, "n h w"]
    ) -> Int[Tensor, "n h w"]:
        """Index in the row of the pixel at whole-numbered position (x, y) of each image.

        Positions outside the image give an empty element whose neighbours at a distance of one
        pixel are empty too. Needs a margin of 3 or more.
        """
        line_count = self.h + 2 * self.margin
        first = torch.arange(self.n, device=x.device)[:, None, None] * line_count + self.margin
        line = first + y.clamp(-2, self.h + 1).long()
        return line * self.pitch + x.clamp(-2, self.w + 1).long()

    def chunks(self, row: Tensor) -> Iterator[tuple[int, int]]:
        """Start and stop of slices that cover all pixels and stay `margin` pixels from the ends.

        One slice on a GPU; several on a CPU, so that each fits its cache.
        """
        start = self.offset(self.margin, 0)
        end = row.shape[-1] - start - self.margin
        size = CHUNK_PIXELS if row.device.type == "cpu" else end - start
        return ((first, min(first + size, end)) for first in range(start, end, size))


def read_windows(
    rows: Float[Tensor, "*c row"], pitch: int, reach: int, step: int
) -> Float[Tensor, "*c side side row"]:
    """The (2 reach + 1)^2 neighbours of each element, `step` pixels apart, in a view.

    `rows` are images whose lines are joined end to end, `pitch` elements long; margins have to
    separate them, at least reach * step elements wide. Beyond both ends are zeros.

    >>> lines = torch.tensor([[1.0, 2, 0, 3, 4, 0]])
    >>> read_windows(lines, pitch=3, reach=1, step=1)[0, :, :, 3].tolist()  # around the 3
    [[0.0, 1.0, 2.0], [0.0, 3.0, 4.0], [0.0, 0.0, 0.0]]
    """
    side, margin = 2 * reach + 1, reach * step * (pitch + 1)
    padded = F.pad(rows, (margin, margin)).contiguous()
    size = (*rows.shape[:-1], side, side, rows.shape[-1])
    return padded.as_strided(size, (*padded.stride()[:-1], step * pitch, step, 1))
