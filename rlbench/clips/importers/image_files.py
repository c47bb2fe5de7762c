"""Untrusted image files, OpenEXR and PNG: the size is checked before pixels are decoded."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from rlbench.clips.exr import read_planes
from rlbench.clips.exr_header import ExrHeader, read_exr_header
from rlbench.clips.importers.limits import check_size
from rlbench.clips.importers.sequence import Pixels, SourceError

COLOURS = ("R", "G", "B")
AXES = ("X", "Y", "Z")


def exr_size(path: Path) -> tuple[int, int]:
    """Height and width of an EXR, pixels. Raises SourceError."""
    with _convert_errors(path):
        return _size(path, read_exr_header(path))


def read_exr(path: Path) -> Pixels:
    """Channels R, G, B or X, Y, Z of a single-part EXR, [h w 3], in the precision of the file.

    Layer names before the last dot are ignored, and so is the case. Raises SourceError where the
    file is broken, too large, or has no such channels.
    """
    with _convert_errors(path):
        header = read_exr_header(path)
        _size(path, header)
        return np.stack(read_planes(path, header, _three_channels(path, header)), axis=-1)


def read_png(path: Path) -> NDArray[np.uint8]:
    """An RGB PNG, [h w 3]; of 16-bit values the upper 8 bits. Raises SourceError.

    Pillow has no 16-bit RGB mode: these are the values that a reader with Pillow or torchvision
    gets.
    """
    with _convert_errors(path), Image.open(path, formats=("PNG",)) as image:
        check_size(path, image.height, image.width)
        if image.mode != "RGB":
            raise SourceError(f"{path} is a PNG of mode {image.mode}, expected RGB")
        return np.array(image)


def png_size(path: Path) -> tuple[int, int]:
    """Height and width of a PNG, pixels. Raises SourceError."""
    with _convert_errors(path), Image.open(path, formats=("PNG",)) as image:
        return check_size(path, image.height, image.width)


def _size(path: Path, header: ExrHeader) -> tuple[int, int]:
    if header.data_window != header.display_window:
        raise SourceError(
            f"{path} has the data window {header.data_window}, expected the whole display window "
            f"{header.display_window}"
        )
    return check_size(path, *header.size)


def _three_channels(path: Path, header: ExrHeader) -> list[str]:
    """The names of the channels R, G, B or X, Y, Z in the file."""
    by_letter = {
        name.rpartition(".")[2].upper(): name
        for name, channel in header.channels.items()
        if channel.is_readable
    }
    for letters in (COLOURS, AXES):
        if by_letter.keys() >= set(letters):
            return [by_letter[letter] for letter in letters]
    raise SourceError(
        f"{path}: expected channels R, G, B or X, Y, Z of half or float; "
        f"it has: {', '.join(header.channels)}"
    )


@contextmanager
def _convert_errors(path: Path) -> Iterator[None]:
    """Raise errors of the decoders as SourceError."""
    try:
        yield
    except SourceError:
        raise
    except (
        *(OSError, RuntimeError, ValueError, KeyError, SyntaxError),
        Image.DecompressionBombError,
    ) as error:
        raise SourceError(f"{path} cannot be decoded, truncated or corrupt ({error})") from error
