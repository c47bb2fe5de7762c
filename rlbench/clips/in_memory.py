"""A clip whose frames are tensors at hand: procedural worlds and training batches."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

from rlbench.frames import Frame, Size


@dataclass(frozen=True)
class InMemoryClip:
    """Frames in memory, of one size. `n` clips may be advanced together."""

    name: str
    scene: str
    digest: str
    frames: Sequence[Frame]

    @cached_property
    def size(self) -> Size:
        """Clips in the batch and pixels of each."""
        return self.frames[0].pool.size

    def __len__(self) -> int:
        """Number of frames."""
        return len(self.frames)

    def __iter__(self) -> Iterator[Frame]:
        """Frames in order."""
        return iter(self.frames)
