"""Read and write one OpenEXR file by channel name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
from numpy.typing import NDArray

from rlbench.clips.exr_header import (
    DeepImageError,
    ExrHeader,
    ExrHeaderError,
    read_exr_header,
)
from rlbench.clips.header import ClipError
from rlbench.system.paths import atomic_write, write_error

__all__ = ["channel_dtype", "read_exr", "read_planes", "write_exr"]

FLOATS: dict[str, type[np.floating]] = {"HALF": np.float16, "FLOAT": np.float32}
DTYPES: dict[str, type[np.number]] = FLOATS | {"UINT": np.uint32}


def write_exr(path: Path, channels: Mapping[str, NDArray[np.floating]]) -> None:
    """Write [h w] arrays of float16 or float32 as a ZIP-compressed scan-line file, atomically.

    Raises `rlbench.system.paths.WriteError` where the disk or the folder takes no file.
    """
    layout = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    pixels = {name: np.ascontiguousarray(values) for name, values in channels.items()}
    with atomic_write(path) as temporary, OpenEXR.File(layout, pixels) as file:
        try:
            file.write(str(temporary))
        except RuntimeError as error:  # the library reports a full disk so, without its number
            raise write_error(path, error) from error


def read_exr(path: Path, names: Sequence[str], height: int, width: int) -> NDArray[np.floating]:
    """The channels `names` as [c h w], in the precision of the file.

    Only these channels are unpacked, though OpenEXR decompresses whole chunks with all their
    channels. Raises ClipError where the file is missing, broken, of another size, or has no such
    channel.
    """
    if not path.is_file():
        raise ClipError(f"{path} is missing; `rlbench render` restores missing frames")
    try:
        header = read_exr_header(path)
        _check(path, header, names, height, width)
        return np.stack(read_planes(path, header, names))
    except (OSError, RuntimeError, MemoryError, ExrHeaderError) as error:
        raise ClipError(
            f"{path} cannot be decoded, truncated or corrupt ({error}); "
            "delete it and run `rlbench render` to trace that frame again"
        ) from error


def read_planes(path: Path, header: ExrHeader, names: Sequence[str]) -> list[NDArray[Any]]:
    """The channels `names` of a file, each [h w] of its data window, in its precision.

    `header` is the file's, or that of the part to read. The channels must have a value in every
    pixel. Raises ExrHeaderError for a part that is deep, damaged or unfinished, and OSError or
    RuntimeError, whichever the library raises, where the pixels cannot be decoded.
    """
    if header.is_deep:
        raise DeepImageError
    if not header.name:
        packed = OpenEXR.InputFile(str(path)).channels(list(names))
        dtypes = [DTYPES[header.channels[name].pixel_type] for name in names]
        return [
            np.frombuffer(b, t).reshape(header.size) for b, t in zip(packed, dtypes, strict=True)
        ]
    with OpenEXR.File(str(path), separate_channels=True) as file:
        # the library leaves out a part that it cannot decode, and the list shifts
        decoded = {part.name(): part.channels for part in file.parts}
        if header.name not in decoded:
            raise ExrHeaderError(f"its part '{header.name}' is damaged or unfinished")
        return [np.array(decoded[header.name][name].pixels) for name in names]


def channel_dtype(path: Path, name: str) -> type[np.floating]:
    """The type of channel `name` in a file, float16 or float32; no pixel is unpacked.

    Raises ClipError where the file is missing, broken, or has no such channel.
    """
    if not path.is_file():
        raise ClipError(f"{path} is missing; `rlbench render` restores missing frames")
    try:
        return FLOATS[read_exr_header(path).channels[name].pixel_type]
    except (OSError, KeyError, ExrHeaderError) as error:
        raise ClipError(f"{path} has no channel {name} of half or float: {error}") from error


def _check(path: Path, header: ExrHeader, names: Sequence[str], h: int, w: int) -> None:
    """Raise ClipError for another size or window, or a channel that is absent or no float."""
    if header.size != (h, w):
        raise ClipError(
            f"{path} is {header.size[1]} x {header.size[0]} pixels, clip.toml says {w} x {h}; "
            "delete the file or correct clip.toml, then run `rlbench render`"
        )
    if header.data_window != header.display_window:
        raise ClipError(
            f"{path} has the data window {header.data_window}, expected its display window "
            f"{header.display_window}: the images of a clip are whole"
        )
    channels = header.channels
    if missing := [name for name in names if name not in channels]:
        raise ClipError(
            f"{path} has no channel {', '.join(missing)}; it has: {', '.join(channels)}"
        )
    if others := [name for name in names if not channels[name].is_float]:
        raise ClipError(
            f"{path}: channel {', '.join(others)} is not half or float with a value in every pixel"
        )
