"""Clips in memory: of tensors, of frames computed when they are read, or of another clip's."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import overload

from rlbench.frames import Clip, Frame, Size


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


@dataclass(frozen=True)
class ClipWrapper:
    """A clip that forwards everything to another clip; override the members that differ."""

    clip: Clip

    @property
    def name(self) -> str:
        """Name of the clip."""
        return self.clip.name

    @property
    def scene(self) -> str:
        """Name of the scene."""
        return self.clip.scene

    @property
    def size(self) -> Size:
        """Number of clips in the batch, height and width."""
        return self.clip.size

    @property
    def digest(self) -> str:
        """Hash of the content."""
        return self.clip.digest

    def __len__(self) -> int:
        """Number of frames."""
        return len(self.clip)

    def __iter__(self) -> Iterator[Frame]:
        """The frames in order."""
        return iter(self.clip)
