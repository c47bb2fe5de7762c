"""A clip whose frames are tensors in memory: procedural clips and training batches."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

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
