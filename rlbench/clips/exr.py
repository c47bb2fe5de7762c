"""Read and write one OpenEXR file by channel name."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path

import numpy as np
import OpenEXR
from numpy.typing import NDArray

from rlbench.clips.header import ClipError, version_1_names
from rlbench.system.paths import atomic_write

TYPES: dict[str, type[np.floating]] = {"HALF": np.float16, "FLOAT": np.float32}


def write_exr(path: Path, channels: Mapping[str, NDArray[np.floating]]) -> None:
    """Write [h w] arrays of float16 or float32 as a ZIP-compressed scan-line file, atomically."""
    layout = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    pixels = {name: np.ascontiguousarray(values) for name, values in channels.items()}
    with atomic_write(path) as temporary, OpenEXR.File(layout, pixels) as file:
        file.write(str(temporary))


def read_exr(path: Path, names: Sequence[str], height: int, width: int) -> NDArray[np.floating]:
    """The channels `names` as [c h w], in the precision of the file.

    A channel may have its name of format version 1 in the file. Only these channels are unpacked,
    though OpenEXR decompresses whole chunks with all their channels. Raises ClipError where the
    file is missing, broken, of another size, or has no such channel.
    """
    if not path.is_file():
        raise ClipError(f"{path} is missing; `rlbench render` restores missing frames")
    try:
        file = OpenEXR.InputFile(str(path))
        header = file.header()
        stored_names = [_stored_name(name, header["channels"]) for name in names]
        _check(path, header, stored_names, height, width)
        packed = file.channels(stored_names)
    except (OSError, RuntimeError) as error:
        raise ClipError(
            f"{path} cannot be decoded, truncated or corrupt ({error}); "
            "delete it and run `rlbench render` to trace that frame again"
        ) from error
    dtypes = [TYPES[str(header["channels"][name].type)] for name in stored_names]
    planes = [
        np.frombuffer(b, t).reshape(height, width) for b, t in zip(packed, dtypes, strict=True)
    ]
    return np.stack(planes)


def channel_dtype(path: Path, name: str) -> type[np.floating]:
    """The type of channel `name` in a file, float16 or float32; no pixel is unpacked.

    Raises ClipError where the file is missing, broken, or has no such channel.
    """
    if not path.is_file():
        raise ClipError(f"{path} is missing; `rlbench render` restores missing frames")
    try:
        return TYPES[str(OpenEXR.InputFile(str(path)).header()["channels"][name].type)]
    except (OSError, RuntimeError, KeyError) as error:
        raise ClipError(f"{path} has no channel {name} of half or float: {error}") from error


def _stored_name(name: str, channels: Collection[str]) -> str:
    """The name of a channel in a file, which may be that of format version 1."""
    buffer, dot, letter = name.partition(".")
    old_name = f"{version_1_names([buffer])[0]}{dot}{letter}"
    return old_name if name not in channels and old_name in channels else name


def _check(path: Path, header: dict[str, object], names: Sequence[str], h: int, w: int) -> None:
    """Raise ClipError for another size, a missing channel, or one of another type."""
    window, channels = header["dataWindow"], header["channels"]
    size = (window.max.y - window.min.y + 1, window.max.x - window.min.x + 1)  # type: ignore[attr-defined]
    if size != (h, w):
        raise ClipError(
            f"{path} is {size[1]} x {size[0]} pixels, clip.toml says {w} x {h}; "
            "delete the file or correct clip.toml, then run `rlbench render`"
        )
    assert isinstance(channels, dict)
    if missing := [name for name in names if name not in channels]:
        raise ClipError(
            f"{path} has no channel {', '.join(missing)}; it has: {', '.join(channels)}"
        )
    if others := [name for name in names if str(channels[name].type) not in TYPES]:
        raise ClipError(f"{path}: channel {', '.join(others)} is not half or float")
