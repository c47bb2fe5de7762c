"""A clip that changes something of another clip."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from rlbench.frames import Clip, Frame, Size

__all__ = ["ClipWrapper"]


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
