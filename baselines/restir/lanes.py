"""Lanes of wavefronts: one per chain and pixel, chains of a pixel next to each other."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from rlbench.pools import RenderContext

__all__ = ["MAX_CHAINS", "Lanes"]

MAX_CHAINS = 2**16  # distance between the random number streams of a chain's passes


@dataclass
class Lanes:
    """Pixels and chains of all lanes, their camera rays and their random numbers."""

    context: RenderContext
    chain_indices: range  # of the chains; they select the random numbers

    def __post_init__(self) -> None:
        """Compute what does not change from frame to frame."""
        import drjit as dr
        import mitsuba as mi

        self.chains = len(self.chain_indices)
        self.count = self.context.height * self.context.width * self.chains
        lane = dr.arange(mi.UInt32, self.count)
        # opaque: other sizes and chains reuse the compiled kernels
        self._chains = dr.opaque(mi.UInt32, self.chains)
        self._first_chain = dr.opaque(mi.UInt32, self.chain_indices.start)
        self._width = dr.opaque(mi.UInt32, self.context.width)
        self._size = [dr.opaque(mi.Float, n) for n in (self.context.width, self.context.height)]
        self._pixel = lane // self._chains
        self._chain = lane - self._pixel * self._chains
        self._row = self._pixel // self._width
        self._column = self._pixel - self._row * self._width
        dr.eval(self._pixel, self._chain, self._row, self._column)

    def camera_rays(self) -> Any:
        """Camera rays of all lanes, jittered within the pixel for each chain and frame."""
        return self._camera_rays(self._pixel, self._chain)

    def camera_rays_of(self, lane: Any) -> Any:
        """Camera rays of other lanes."""
        pixel = lane // self._chains
        return self._camera_rays(pixel, lane - pixel * self._chains)

    def random_numbers(self, purpose: int) -> Any:
        """A sampler for all lanes, independent for each `purpose`; 0 begins with the jitter."""
        return self.context.sampler(
            self._pixel, self._first_chain + self._chain + MAX_CHAINS * purpose
        )

    def previous(self) -> tuple[Any, Any]:
        """The lane at each pixel's position in the previous frame, and whether it exists."""
        import drjit as dr
        import mitsuba as mi

        x, y = (dr.gather(mi.Float, part, self._pixel) for part in self.context.motion())
        return self.at_offset(x, y)

    def at_offset(self, x: Any, y: Any) -> tuple[Any, Any]:
        """The lane of the same chain x pixels right and y down, and whether it exists."""
        import drjit as dr
        import mitsuba as mi

        column = dr.floor(mi.Float(self._column) + 0.5 + x)
        row = dr.floor(mi.Float(self._row) + 0.5 + y)
        width, height = self._size
        inside = (column >= 0) & (row >= 0) & (column < width) & (row < height)
        pixel = mi.UInt32(dr.select(inside, row, 0)) * self._width
        pixel += mi.UInt32(dr.select(inside, column, 0))
        return pixel * self._chains + self._chain, inside

    def _camera_rays(self, pixel: Any, chain: Any) -> Any:
        import mitsuba as mi

        jitter = self.context.sampler(pixel, self._first_chain + chain).next_2d()
        row = pixel // self._width
        column = pixel - row * self._width
        return self.context.camera_rays(mi.Float(column) + jitter.x, mi.Float(row) + jitter.y)
