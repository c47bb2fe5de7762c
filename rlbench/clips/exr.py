"""One OpenEXR file: named channels in, the channels that are asked for out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import OpenEXR
from numpy.typing import NDArray

from rlbench.clips.header import ClipError
from rlbench.system.paths import replacing

TYPES: dict[str, type[np.floating]] = {"HALF": np.float16, "FLOAT": np.float32}


def write_exr(path: Path, channels: Mapping[str, NDArray[np.floating]]) -> None:
    """Write [h w] arrays of float16 or float32 as a scan-line file (ZIP), whole or not at all."""
    layout = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    pixels = {name: np.ascontiguousarray(values) for name, values in channels.items()}
    with replacing(path) as temporary, OpenEXR.File(layout, pixels) as file:
        file.write(str(temporary))


def read_exr(path: Path, names: Sequence[str], height: int, width: int) -> NDArray[np.floating]:
    """The channels `names` as [c h w], as precise as the file holds them.

    Only these channels are unpacked, though OpenEXR decompresses whole chunks, all channels
    together. Raises ClipError where the file is missing, broken, of another size, or has no such
    channel.
    """
    if not path.is_file():
        raise ClipError(f"{path} is missing; `rlbench render` restores missing frames")
    try:
        file = OpenEXR.InputFile(str(path))
        header = file.header()
        _check(path, header, names, height, width)
        packed = file.channels(list(names))
    except (OSError, RuntimeError) as error:
        raise ClipError(
            f"{path} cannot be decoded, truncated or corrupt ({error}); "
            "delete it and run `rlbench render` to trace that frame again"
        ) from error
    kinds = [TYPES[str(header["channels"][name].type)] for name in names]
    planes = [
        np.frombuffer(b, k).reshape(height, width) for b, k in zip(packed, kinds, strict=True)
    ]
    return np.stack(planes)


def precision(path: Path, name: str) -> type[np.floating]:
    """float16 or float32, as channel `name` of a file is stored; no pixel is unpacked.

    Raises ClipError where the file is missing, broken, or has no such channel.
    """
    if not path.is_file():
        raise ClipError(f"{path} is missing; `rlbench render` restores missing frames")
    try:
        return TYPES[str(OpenEXR.InputFile(str(path)).header()["channels"][name].type)]
    except (OSError, RuntimeError, KeyError) as error:
        raise ClipError(f"{path} has no channel {name} of half or float: {error}") from error


def _check(path: Path, header: dict[str, object], names: Sequence[str], h: int, w: int) -> None:
    window, channels = header["dataWindow"], header["channels"]
    found = (window.max.y - window.min.y + 1, window.max.x - window.min.x + 1)  # type: ignore[attr-defined]
    if found != (h, w):
        raise ClipError(
            f"{path} is {found[1]} x {found[0]} pixels, clip.toml says {w} x {h}; "
            "delete the file or correct clip.toml, then `rlbench render`"
        )
    assert isinstance(channels, dict)
    if absent := [name for name in names if name not in channels]:
        raise ClipError(f"{path} has no channel {', '.join(absent)}; it has: {', '.join(channels)}")
    if odd := [name for name in names if str(channels[name].type) not in TYPES]:
        raise ClipError(f"{path}: channel {', '.join(odd)} is not half or float")
