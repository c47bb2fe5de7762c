"""The interface of the importers: a sequence of frames, and how one of its frames is read."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rlbench.clips.exr import Window
from rlbench.clips.header import LIMITS
from rlbench.clips.image_files import Pixels
from rlbench.errors import SourceError

MAX_CLIP_NAME = 80  # bytes, so that files that are named after a clip have room for more
MAX_FRAMES = int(LIMITS["frames"].highest)


class ImportedFrame(NamedTuple):
    """One frame in the conventions of a clip. Radiance is linear."""

    gbuffer: dict[str, Pixels]  # h w c, by buffer name
    pool: Pixels  # s h w 3, independent 1-spp images
    half_a: Pixels  # h w 3, the reference, or one half of it
    half_b: Pixels  # h w 3, the same again, or the other half
    broken: Mapping[str, NDArray[np.bool_]] = {}  # h w 1, by buffer: replaced by background
    empty: Mapping[str, NDArray[np.bool_]] = {}  # h w 1, by image: outside the data window
    files: Mapping[str, Path] = {}  # by image, the first whose values are not finite
    counts: Mapping[str, int] = {}  # of what is unusual in the images, see Findings


@dataclass(frozen=True, kw_only=True)
class ImportedSequence:
    """Consecutive frames of one source, which become one clip."""

    name: str  # of the clip and of its folder
    sampler: str  # what traced the samples, as far as that is known
    height: int  # pixels
    width: int  # pixels
    numbers: tuple[int, ...]  # frame numbers in the source
    first_number: int = 0  # of all in the source, to which the first pose of a camera belongs
    counts: tuple[int, ...]  # 1-spp images of each frame
    reference_spp: tuple[int, ...]  # samples per pixel of each reference; 0 where unknown
    buffers: tuple[str, ...]  # of the G-buffer
    limitations: tuple[str, ...]  # keys of `rlbench.clips.header.LIMITATIONS`
    files: tuple[Path, ...]  # all files that are read
    frame_files: tuple[tuple[Path, ...], ...] = ()  # of each frame of a dump; first its radiance
    window: Window | None = None  # of the images, where it is not the display window
    read: Callable[[int, int], ImportedFrame]  # reads (frame number, samples per pixel)
    jitter: tuple[tuple[float, float], ...] = ()  # offset of the samples of each frame, pixels
    fps: float = 24.0  # frames per second
    exposure: float | None = None  # that suits the source; None: from its luminance
    convention: str = ""  # what else decides the frames, for telling one import from another
    notes: tuple[str, ...] = ()  # about the source, for its user

    @property
    def radiance(self) -> tuple[Path, ...]:
        """The first file of radiance of each frame of a dump."""
        return tuple(files[0] for files in self.frame_files)


def parse_frame_range(text: str) -> tuple[int, int]:
    """The first frame and the end, exclusive, of a range FIRST:END. Raises SourceError.

    >>> parse_frame_range("0:20"), parse_frame_range("-3:0")
    ((0, 20), (-3, 0))
    """
    match = re.fullmatch(r"(-?\d{1,18}):(-?\d{1,18})", text)
    if not match or int(match[1]) >= int(match[2]):
        raise SourceError(
            f"'{text}' is not a range of frames; --frames takes FIRST:END, for example 0:20"
        )
    return int(match[1]), int(match[2])


def select_frames(
    label: str, numbers: Iterable[int], frames: tuple[int, int] | None
) -> tuple[int, ...]:
    """The frame numbers in the range `frames`, or all of them.

    Raises SourceError where a frame between first and last is missing, or there are too many.
    `label` names the sequence in the message.
    """
    existing = set(numbers)
    first, end = frames or (min(existing), max(existing) + 1)
    if end - first > MAX_FRAMES:
        raise SourceError(
            f"{label}: frames {first} to {end - 1} are {end - first}, and a clip has at most "
            f"{MAX_FRAMES}; there are {len(existing)} files between {min(existing)} and "
            f"{max(existing)}. Select fewer with --frames FIRST:END, or correct the file names"
        )
    check_complete(label, range(first, end), existing)
    return tuple(range(first, end))


def check_complete(label: str, required: Collection[int], existing: Collection[int]) -> None:
    """Raise SourceError where a required frame does not exist. `label` is what needs it."""
    if missing := sorted(set(required) - set(existing)):
        listed = ", ".join(map(str, missing[:8])) + (" ..." if len(missing) > 8 else "")
        raise SourceError(
            f"{label}: frames {min(required)} to {max(required)} are required and {len(missing)} "
            f"of them are missing: {listed}; there are {len(existing)} between {min(existing)} "
            f"and {max(existing)}. Select a range without gaps with --frames FIRST:END"
        )


def clip_name(*parts: str) -> str:
    """A clip name from names in the source, safe as a folder name, and another one for another.

    Accents are composed. What else a name cannot have becomes a dash, and what is beyond 80 bytes
    is cut; a hash at the end then tells such names apart.

    >>> clip_name("hall", "night"), clip_name("render (1)"), clip_name("A&B")
    ('hall-night', 'render -1-0e94', 'A-B-ea99')
    """
    given = unicodedata.normalize("NFC", "-".join(part for part in parts if part))
    plain = re.sub(r"[^\w .+-]+", "-", given).encode()[:MAX_CLIP_NAME].decode(errors="ignore")
    name = plain.strip("-.+ ") or "shot"
    if given == name:
        return name
    digest = sha256(given.encode(errors="surrogateescape")).hexdigest()[:4]
    return f"{name}-{digest}"
