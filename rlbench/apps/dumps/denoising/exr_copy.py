"""Copy an OpenEXR file with other pixels in some of its channels; all else stays."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import OpenEXR
from numpy.typing import NDArray

from rlbench.clips.exr import ExrHeader, ExrHeaderError, Window, read_exr_parts
from rlbench.clips.exr_attributes import BY_LIBRARY, hide_attributes, show_attributes
from rlbench.errors import RlbenchError
from rlbench.system.paths import atomic_write, write_error

LOSSY = (
    *(OpenEXR.PXR24_COMPRESSION, OpenEXR.B44_COMPRESSION, OpenEXR.B44A_COMPRESSION),
    *(OpenEXR.DWAA_COMPRESSION, OpenEXR.DWAB_COMPRESSION, OpenEXR.LJ2K_COMPRESSION),
)


@dataclass(frozen=True)
class NewPixels:
    """Channels of one part of a file, and what takes their place."""

    header: ExrHeader  # of the part
    planes: Mapping[str, NDArray[np.floating]]  # by channel, each [h w] of the window
    window: Window | None = None  # None: the display window

    def put(self, part: OpenEXR.Part) -> None:
        """Replace the pixels of the part that lie in both windows; half numbers end at 65504."""
        left, top, right, bottom = self.header.data_window
        x, y, x_end, y_end = self.window or self.header.display_window
        rows = slice(max(top, y), min(bottom, y_end) + 1)
        columns = slice(max(left, x), min(right, x_end) + 1)
        for name, plane in self.planes.items():
            channel = part.channels[name]
            pixels = channel.pixels.copy()
            most = np.finfo(pixels.dtype).max
            inside = plane[_shift(rows, y), _shift(columns, x)].clip(-most, most)
            pixels[_shift(rows, top), _shift(columns, left)] = inside
            channel.pixels = pixels


def replace_channels(source: Path, target: Path, *images: NewPixels) -> None:
    """Write a copy of a file, atomically, in which some channels have other pixels.

    These are stored in the types that the channels have. Attributes, other channels and other parts
    stay, bit by bit: a file that is packed with loss is written as ZIP. Raises ExrHeaderError for a
    damaged part, and WriteError.
    """
    try:
        _replace(source, target, images, {})
    except BY_LIBRARY as error:
        if isinstance(error, RlbenchError):
            raise
        with hide_attributes(source) as (copy, hidden):
            _replace(copy, target, images, hidden)


def _replace(
    source: Path,
    target: Path,
    images: tuple[NewPixels, ...],
    hidden: dict[tuple[int, str], bytes],
) -> None:
    with OpenEXR.File(str(source), separate_channels=True) as file:
        parts = {part.name(): part for part in file.parts}
        is_whole = len(file.parts) == len(read_exr_parts(source))
        for image in images:
            part = parts.get(image.header.name) if image.header.is_part else file.parts[0]
            if part is None or not is_whole:
                raise ExrHeaderError("one of its parts is damaged or unfinished")
            image.put(part)
        for part in file.parts:
            if part.header["compression"] in LOSSY:
                part.header["compression"] = OpenEXR.ZIP_COMPRESSION
        with atomic_write(target) as temporary:
            try:
                file.write(str(temporary))
            except RuntimeError as error:
                if hidden:
                    raise write_error(target, error) from error
                raise
            show_attributes(temporary, hidden)


def _shift(side: slice, by: int) -> slice:
    return slice(side.start - by, side.stop - by)
