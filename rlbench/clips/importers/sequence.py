"""What every format hands over: a run of frames, what is known of it, and how one is read."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rlbench.errors import RlbenchError

Pixels = NDArray[np.floating]


class SourceError(RlbenchError, ValueError):
    """Files that cannot be imported as asked, or that are not safe to read."""


class ImportedFrame(NamedTuple):
    """One frame in the conventions of a clip. Radiance is linear."""

    gbuffer: dict[str, Pixels]  # h w c, by buffer name
    pool: Pixels  # s h w 3, independent 1-spp images
    half_a: Pixels  # h w 3, the reference, or one half of it
    half_b: Pixels  # h w 3, the same again, or the other half


@dataclass(frozen=True, kw_only=True)
class ImportedSequence:
    """Consecutive frames of one source. `lacks` names what it has not, in the header's words."""

    name: str  # of the clip, and of the folder it goes to
    sampler: str  # what traced it, as far as that is known
    height: int  # pixels
    width: int  # pixels
    numbers: tuple[int, ...]  # of the frames, as the source counts them
    counts: tuple[int, ...]  # 1-spp images that each of them has
    reference_spp: tuple[int, ...]  # samples per pixel of each reference; 0 where unknown
    buffers: tuple[str, ...]  # of the view
    lacks: tuple[str, ...]
    files: tuple[Path, ...]  # all that is read
    read: Callable[[int, int], ImportedFrame]  # a frame's number, and how many samples of it
    fps: float = 24.0


def span(text: str) -> tuple[int, int]:
    """The frames FIRST:END, END excluded, as numbers. Raises SourceError."""
    match = re.fullmatch(r"(\d+):(\d+)", text)
    if not match or int(match[1]) >= int(match[2]):
        raise SourceError(f"--frames takes FIRST:END such as 0:20 and was given '{text}'")
    return int(match[1]), int(match[2])


def consecutive(
    what: str, numbers: Iterable[int], wanted: tuple[int, int] | None
) -> tuple[int, ...]:
    """The frames that are wanted, or all; SourceError where one between first and last is missing.

    `what` names the sequence, or the images of which one is missing.
    """
    there = set(numbers)
    first, end = wanted or (min(there), max(there) + 1)
    if missing := [number for number in range(first, end) if number not in there]:
        told = ", ".join(map(str, missing[:8])) + (" ..." if len(missing) > 8 else "")
        raise SourceError(
            f"{what}: frames {first} to {end - 1} are wanted and {len(missing)} of them are "
            f"missing: {told}; there are {len(there)} between {min(there)} and {max(there)}. "
            "Take a part without gaps with --frames FIRST:END"
        )
    return tuple(range(first, end))


def clip_name(*parts: str) -> str:
    """A name from the source's own, safe as a folder's. Raises SourceError where it is not."""
    name = "-".join(part for part in parts if part)
    if not re.fullmatch(r"\w[\w .+-]*", name):
        raise SourceError(f"'{name}' cannot be a clip's name; rename the files or their folder")
    return name
