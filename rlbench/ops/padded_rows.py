"""Images in one row with margins between lines, so that a neighbour is a fixed distance away."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn import functional as F

PIECE = 1 << 16  # pixels filtered at a time on a CPU: in its cache, and enough for two threads


@dataclass(frozen=True)
class PaddedRows:
    """How n images of h x w pixels lie in one row, `margin` empty pixels around each.

    A line ends in `margin` empty pixels, and as many empty lines lie before and after an image.
    Whatever is up to `margin` pixels away, down or across, is then a pixel of the same image or
    empty, `offset(down, right)` places further along the row. Filters over many neighbours run
    along slices of the row: no borders to test, and all memory is read in order.
    """

    n: int
    h: int
    w: int
    margin: int

    @property
    def pitch(self) -> int:
        """Places from a pixel to the one below."""
        return self.w + self.margin

    def offset(self, down: int, right: int) -> int:
        """Places from a pixel to another, both at most `margin` pixels away."""
        return down * self.pitch + right

    def pack(self, image: Float[Tensor, "n c h w"], empty: float = 0.0) -> Float[Tensor, "c row"]:
        """The images in a row, with `empty` in the margins."""
        m = self.margin
        return F.pad(image, (0, m, m, m), value=empty).transpose(0, 1).reshape(image.shape[1], -1)

    def unpack(self, row: Float[Tensor, "c row"]) -> Float[Tensor, "n c h w"]:
        """The images again."""
        images = row.view(row.shape[0], self.n, -1, self.pitch).transpose(0, 1)
        return images[:, :, self.margin : self.margin + self.h, : self.w]

    def places(self, x: Float[Tensor, "n h w"], y: Float[Tensor, "n h w"]) -> Int[Tensor, "n h w"]:
        """Where the row holds whole positions; those far outside lead to an empty place.

        From there one pixel in each direction is empty too. Needs a margin of 3 or more.
        """
        lines = self.h + 2 * self.margin
        first = torch.arange(self.n, device=x.device)[:, None, None] * lines + self.margin
        line = first + y.clamp(-2, self.h + 1).long()
        return line * self.pitch + x.clamp(-2, self.w + 1).long()

    def pieces(self, row: Tensor) -> Iterator[tuple[int, int]]:
        """Starts and stops of slices that cover all pixels and can look `margin` pixels ahead.

        A graphics card gets one slice; the cache of a CPU does better with several.
        """
        ahead = self.offset(self.margin, 0)
        start, end = ahead, row.shape[-1] - ahead - self.margin
        size = PIECE if row.device.type == "cpu" else end - start
        return ((at, min(at + size, end)) for at in range(start, end, size))
