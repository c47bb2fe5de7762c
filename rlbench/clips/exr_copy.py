"""Copy an OpenEXR file with other pixels in some of its channels; all else stays."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import OpenEXR
from numpy.typing import NDArray

from rlbench.clips.exr import ExrHeader, ExrHeaderError, read_exr_parts
from rlbench.clips.exr_attributes import BY_LIBRARY, hide_attributes, show_attributes
from rlbench.errors import RlbenchError
from rlbench.system.paths import atomic_write, write_error

LOSSY = (
    *(OpenEXR.PXR24_COMPRESSION, OpenEXR.B44_COMPRESSION, OpenEXR.B44A_COMPRESSION),
    *(OpenEXR.DWAA_COMPRESSION, OpenEXR.DWAB_COMPRESSION, OpenEXR.LJ2K_COMPRESSION),
)


def replace_channels(
    source: Path, target: Path, header: ExrHeader, planes: Mapping[str, NDArray[np.floating]]
) -> None:
    """Write a copy of a file, atomically, in which some channels of one part have other pixels.

    `header` is that of the part in `source`, `planes` are [h w] of its display window, and are
    stored in the types that the channels have; half numbers end at 65504. Attributes, other
    channels and other parts stay, bit by bit: a file that is packed with loss is written as ZIP.
    Raises ExrHeaderError for a damaged part, and WriteError.
    """
    try:
        _replace(source, target, header, planes, {})
    except BY_LIBRARY as error:
        if isinstance(error, RlbenchError):
            raise
        with hide_attributes(source) as (copy, hidden):
            _replace(copy, target, header, planes, hidden)


def _replace(
    source: Path,
    target: Path,
    header: ExrHeader,
    planes: Mapping[str, NDArray[np.floating]],
    hidden: dict[tuple[int, str], bytes],
) -> None:
    with OpenEXR.File(str(source), separate_channels=True) as file:
        parts = {part.name() if header.is_part else "": part for part in file.parts}
        if header.name not in parts or len(file.parts) != len(read_exr_parts(source)):
            raise ExrHeaderError("one of its parts is damaged or unfinished")
        left, top, right, bottom = header.data_window
        x, y = header.display_window[:2]
        h, w = header.display_size
        rows = slice(max(top, y), min(bottom, y + h - 1) + 1)
        columns = slice(max(left, x), min(right, x + w - 1) + 1)
        for name, plane in planes.items():
            channel = parts[header.name].channels[name]
            pixels = channel.pixels.copy()
            most = np.finfo(pixels.dtype).max
            inside = plane[_shift(rows, y), _shift(columns, x)].clip(-most, most)
            pixels[_shift(rows, top), _shift(columns, left)] = inside
            channel.pixels = pixels
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
