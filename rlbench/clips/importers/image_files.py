"""Images by strangers: an OpenEXR or a PNG, whose size is looked at before it is unpacked."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
from numpy.typing import NDArray
from PIL import Image

from rlbench.clips.exr import TYPES
from rlbench.clips.importers.limits import check_size
from rlbench.clips.importers.sequence import Pixels, SourceError

COLOURS = ("R", "G", "B")
AXES = ("X", "Y", "Z")


def exr_size(path: Path) -> tuple[int, int]:
    """Height and width of an EXR, pixels. Raises SourceError."""
    with _understood(path):
        return _size(path, OpenEXR.InputFile(str(path)).header())


def read_exr(path: Path) -> Pixels:
    """Channels R, G, B, or X, Y, Z, of an EXR of one part, [h w 3], as precise as the file.

    Names count from the last dot and in either case. Raises SourceError where the file is broken,
    too large, or has no such channels.
    """
    with _understood(path):
        file = OpenEXR.InputFile(str(path))
        header = file.header()
        height, width = _size(path, header)
        names = _three(path, header["channels"])
        packed = file.channels(names)
        kinds = [TYPES[str(header["channels"][name].type)] for name in names]
        planes = [
            np.frombuffer(b, k).reshape(height, width) for b, k in zip(packed, kinds, strict=True)
        ]
    return np.stack(planes, axis=-1)


def read_png(path: Path) -> NDArray[np.uint8]:
    """A PNG of three colours, [h w 3], of 8 bits; of 16 bits the upper 8. Raises SourceError.

    Pillow has no three 16-bit colours: this is what a reader with Pillow or torchvision sees.
    """
    with _understood(path), Image.open(path, formats=("PNG",)) as image:
        check_size(path, image.height, image.width)
        if image.mode != "RGB":
            raise SourceError(f"{path} is a PNG of mode {image.mode}, expected RGB")
        return np.array(image)


def png_size(path: Path) -> tuple[int, int]:
    """Height and width of a PNG, pixels. Raises SourceError."""
    with _understood(path), Image.open(path, formats=("PNG",)) as image:
        return check_size(path, image.height, image.width)


def _size(path: Path, header: Any) -> tuple[int, int]:
    window, shown = header["dataWindow"], header["displayWindow"]
    if str(window) != str(shown):
        raise SourceError(f"{path} holds the window {window} of {shown}, expected all of it")
    return check_size(path, window.max.y - window.min.y + 1, window.max.x - window.min.x + 1)


def _three(path: Path, channels: Any) -> list[str]:
    """The names of the three channels."""
    plain = {
        name.rpartition(".")[2].upper(): name
        for name, channel in channels.items()
        if str(channel.type) in TYPES and channel.xSampling == channel.ySampling == 1
    }
    for letters in (COLOURS, AXES):
        if plain.keys() >= set(letters):
            return [plain[letter] for letter in letters]
    have = ", ".join(channels)
    raise SourceError(
        f"{path}: expected channels R, G, B or X, Y, Z of half or float; it has: {have}"
    )


@contextmanager
def _understood(path: Path) -> Iterator[None]:
    """Errors of the decoders become SourceError."""
    try:
        yield
    except SourceError:
        raise
    except (
        *(OSError, RuntimeError, ValueError, KeyError, SyntaxError),
        Image.DecompressionBombError,
    ) as error:
        raise SourceError(f"{path} cannot be decoded, truncated or corrupt ({error})") from error
