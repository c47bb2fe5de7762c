"""A clip whose frames are tensors in memory, stored or computed when they are read."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import overload

from rlbench.frames import Frame, Size


@dataclass(frozen=True)
class InMemoryClip:
    """A `Clip` from a sequence of frames of one size. Its tensors may hold `n` clips as a batch."""

    name: str
    scene: str
    digest: str
    frames: Sequence[Frame]

    @cached_property
    def size(self) -> Size:
        """Number of clips in the batch, and height and width of their images."""
        return self.frames[0].pool.size

    def __len__(self) -> int:
        """Number of frames."""
        return len(self.frames)

    def __iter__(self) -> Iterator[Frame]:
        """Frames in order."""
        return iter(self.frames)


@dataclass(frozen=True)
class ComputedFrames(Sequence[Frame]):
    """`length` frames, each computed from its index whenever it is read."""

    length: int
    compute: Callable[[int], Frame]

    def __len__(self) -> int:
        """Number of frames."""
        return self.length

    @overload
    def __getitem__(self, index: int) -> Frame: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[Frame]: ...
    def __getitem__(self, index: int | slice) -> Frame | Sequence[Frame]:
        """One frame, or the frames of a slice."""
        if isinstance(index, slice):
            return tuple(map(self.compute, range(self.length)[index]))
        return self.compute(range(self.length)[index])
