"""Untrusted image files, OpenEXR and PNG: the size is checked before pixels are decoded."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from fnmatch import fnmatchcase
from pathlib import Path

import numpy as np
import OpenEXR
from numpy.typing import NDArray
from PIL import Image

from rlbench.clips.exr import read_planes
from rlbench.clips.exr_header import ExrHeader, read_exr_parts
from rlbench.clips.importers.limits import check_size
from rlbench.clips.importers.sequence import Pixels, SourceError

Alternatives = Sequence[Sequence[str]]  # lists of channel names, the preferred one first


def exr_size(path: Path) -> tuple[int, int]:
    """Height and width of the first part of an EXR, pixels. Raises SourceError."""
    with _convert_errors(path):
        return _size(path, read_exr_parts(path)[0])


def read_exr(path: Path, alternatives: Alternatives, part: str = "") -> Pixels:
    """Channels of one part of an EXR, [h w c], in the precision of the file.

    The first list of names is read whose channels one part has. A name is that of a channel, of a
    part and its channel (`albedo.R`), a pattern with `*`, or after a leading `*.` the last word of
    a name, in any case. `part` selects a part by its name.

    Raises SourceError where the file is broken, too large, or has no such channels.
    """
    with _convert_errors(path):
        headers = read_exr_parts(path)
        index, names = _find_channels(path, headers, alternatives, part)
        _size(path, headers[index])
        if len(headers) == 1:
            planes = read_planes(path, headers[0], names)
        else:
            with OpenEXR.File(str(path), separate_channels=True) as file:
                channels = file.parts[index].channels
                planes = [np.array(channels[name].pixels) for name in names]
        return np.stack(planes, axis=-1)


def has_channels(path: Path, alternatives: Alternatives, part: str = "") -> bool:
    """Whether `read_exr` finds these channels. Raises SourceError where the file is broken."""
    with _convert_errors(path):
        headers = read_exr_parts(path)
    return _locate(path, headers, alternatives, part) is not None


def list_channels(path: Path) -> dict[str, list[str]]:
    """The half and float channels of each part of an EXR, by the part's name. Raises SourceError.

    The only part of a single-part file has an empty name.
    """
    with _convert_errors(path):
        return {header.name: _readable(header) for header in read_exr_parts(path)}


def _find_channels(
    path: Path, headers: Sequence[ExrHeader], alternatives: Alternatives, part: str
) -> tuple[int, list[str]]:
    """The part that has the channels of one alternative, and their names there."""
    if found := _locate(path, headers, alternatives, part):
        return found
    parts = "; ".join(
        f"{header.name + ': ' if header.name else ''}{', '.join(_readable(header)[:24])}"
        for header in headers
    )
    expected = " or ".join(", ".join(names).replace("*.", "") for names in alternatives)
    where = f" in the part '{part}'" if part else ""
    raise SourceError(f"{path}: expected channels {expected}{where}; it has: {parts}")


def _locate(
    path: Path, headers: Sequence[ExrHeader], alternatives: Alternatives, part: str
) -> tuple[int, list[str]] | None:
    for names in alternatives:
        for index, header in enumerate(headers):
            if not part or fnmatchcase(header.name, part):
                found = [_find_channel(path, header, name) for name in names]
                if all(found):
                    return index, [name for name in found if name]
    return None


def _find_channel(path: Path, header: ExrHeader, pattern: str) -> str | None:
    """The only channel that a pattern matches, or None. Raises SourceError for several."""
    names = _readable(header)
    if pattern in names:
        return pattern
    aliases = {f"{header.name}.{name}": name for name in names} | {name: name for name in names}
    if pattern in aliases:
        return aliases[pattern]
    letter = pattern[2:].upper() if pattern.startswith("*.") else None
    found = {name for name in names if name.upper() == letter}
    if not found:
        found = {name for alias, name in aliases.items() if fnmatchcase(alias, pattern)}
    if len(found) > 1:
        raise SourceError(
            f"{path}: '{pattern}' matches several channels: {', '.join(sorted(found))}; "
            "name one of them in `channels`, or a `part`"
        )
    return next(iter(found), None)


def _readable(header: ExrHeader) -> list[str]:
    return [name for name, channel in header.channels.items() if channel.is_readable]


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
