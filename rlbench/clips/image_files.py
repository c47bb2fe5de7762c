"""Untrusted image files, OpenEXR and PNG: the size is checked before pixels are decoded."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from fnmatch import fnmatchcase
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from rlbench.clips.exr import (
    DeepImageError,
    ExrHeader,
    ExrHeaderError,
    Window,
    read_exr_parts,
    read_planes,
    window_size,
)
from rlbench.clips.primaries import convert_to_rec709
from rlbench.errors import SourceError

Pixels = NDArray[np.floating]
MAX_IMAGE_PIXELS = 2**28  # 16384 x 16384
COMPOSITE = "Composite."  # Blender's layer of the compositor, which is read only where it is named


class Channels(NamedTuple):
    """Which channels to read: lists of names, of which the first is read that one part has.

    A name is that of a channel, of a part and its channel (`albedo.R`), a pattern with `*`, or
    after a leading `*.` the last word of a name, in any case. `part` selects parts by name or
    pattern. `layer` decides where a pattern matches the channels of several layers.
    """

    alternatives: Sequence[Sequence[str]]
    part: str = ""
    layer: str = ""


class ExrImage(NamedTuple):
    """The pixels of a window, of which the file may have only some, or others too."""

    pixels: Pixels  # h w c, in the precision of the file; of UINT channels float64
    empty: NDArray[np.bool_]  # h w 1, outside the data window
    cut: int  # pixels of the data window outside this window
    header: ExrHeader


def check_size(path: Path, height: int, width: int) -> tuple[int, int]:
    """The size that an image claims to have, if it is within the limits. Raises SourceError."""
    if min(height, width) < 1 or height * width > MAX_IMAGE_PIXELS:
        raise SourceError(
            f"{path} claims to be {width} x {height} pixels; from 1 to {MAX_IMAGE_PIXELS} are read"
        )
    return height, width


def exr_size(path: Path, channels: Channels) -> tuple[int, int]:
    """Height and width of the image that has these channels, pixels. Raises SourceError."""
    return check_size(path, *find_channels(path, channels)[0].display_size)


def read_exr(
    path: Path, alternatives: Sequence[Sequence[str]], part: str = "", fill: float = 0.0
) -> Pixels:
    """Channels of one part of an EXR, [h w c], as `read_exr_image` reads them."""
    return read_exr_image(path, Channels(alternatives, part), fill).pixels


def read_exr_image(
    path: Path, channels: Channels, fill: float = 0.0, window: Window | None = None
) -> ExrImage:
    """Channels of one part of an EXR: a window of it, with `fill` where there are no data.

    The default is the display window. Raises SourceError where the file is broken, too large, deep,
    has no such channels, or no data inside the window.
    """
    with _convert_errors(path):
        header, names = _find_channels(path, read_exr_parts(path), channels)
        window = window or header.display_window
        h, w = check_size(path, *window_size(window))
        source, target = _overlap(path, header.data_window, window)
        planes = [
            plane.astype(np.float64) if plane.dtype.kind == "u" else plane
            for plane in read_planes(path, header, names)
        ]
        data = np.stack(planes, axis=-1)
        empty = np.ones((h, w, 1), bool)
        empty[target] = False
        pixels = data
        if header.data_window != window:
            pixels = np.full((h, w, len(names)), fill, data.dtype)
            pixels[target] = data[source]
        return ExrImage(pixels, empty, data[..., 0].size - int((~empty).sum()), header)


def to_rec709(path: Path, pixels: Pixels, header: ExrHeader) -> tuple[Pixels, int]:
    """Colours [h w 3] of a file with Rec. 709 primaries, and how many pixels these cannot show.

    Pixels of another number of channels stay. Raises SourceError where the header does not say
    which primaries its colours have.
    """
    try:
        primaries = header.primaries if pixels.shape[-1] == 3 else None
    except ExrHeaderError as error:
        raise SourceError(f"{path}: {error}") from error
    if primaries is None:
        return pixels, 0
    converted, outside = convert_to_rec709(pixels, primaries)
    return converted, int(outside.sum())


def find_channels(path: Path, channels: Channels) -> tuple[ExrHeader, list[str]]:
    """The part that `read_exr` reads, and the names of its channels. Raises SourceError."""
    with _convert_errors(path):
        return _find_channels(path, read_exr_parts(path), channels)


def has_channels(path: Path, channels: Channels) -> bool:
    """Whether `read_exr` finds these channels. Raises SourceError where the file is broken."""
    with _convert_errors(path):
        return _locate(path, read_exr_parts(path), channels) is not None


def list_channels(path: Path) -> dict[str, list[str]]:
    """The channels with a value in every pixel of each part of an EXR, by the part's name.

    The only part of a single-part file has an empty name; deep parts are left out. Raises
    SourceError.
    """
    with _convert_errors(path):
        headers = read_exr_parts(path)
        if all(header.is_deep for header in headers):
            raise DeepImageError
        return {header.name: _full(header) for header in headers if not header.is_deep}


def _overlap(
    path: Path, data: Window, image: Window
) -> tuple[tuple[slice, slice], tuple[slice, slice]]:
    """Rows and columns that both windows share: in the data, and in the image."""
    x, y = max(data[0], image[0]), max(data[1], image[1])
    x_end, y_end = min(data[2], image[2]) + 1, min(data[3], image[3]) + 1
    if x >= x_end or y >= y_end:
        raise SourceError(
            f"{path} has no pixel of its image: the data window {data} lies outside the display "
            f"window {image}"
        )

    def window(left: int, top: int) -> tuple[slice, slice]:
        return slice(y - top, y_end - top), slice(x - left, x_end - left)

    return window(*data[:2]), window(*image[:2])


def _find_channels(
    path: Path, headers: Sequence[ExrHeader], channels: Channels
) -> tuple[ExrHeader, list[str]]:
    """The part that has the channels of one alternative, and their names there."""
    found = _locate(path, headers, channels)
    read = [found[0]] if found else _select_parts(headers, channels.part)
    if any(header.is_deep for header in read):
        raise DeepImageError
    if found:
        return found
    parts = "; ".join(
        f"{header.name + ': ' if header.name else ''}{', '.join(_full(header)[:24]) or 'nothing'}"
        for header in headers
    )
    expected = " or ".join(", ".join(names).replace("*.", "") for names in channels.alternatives)
    where = f" in the part '{channels.part}'" if channels.part else ""
    others = [
        f"{name} ({channel.x_sampling} x {channel.y_sampling})"
        for header in headers
        for name, channel in header.channels.items()
        if not channel.is_full
    ]
    subsampled = f"; subsampled ones are not read: {', '.join(others)}" if others else ""
    raise SourceError(f"{path}: expected channels {expected}{where}; it has: {parts}{subsampled}")


def _locate(
    path: Path, headers: Sequence[ExrHeader], channels: Channels
) -> tuple[ExrHeader, list[str]] | None:
    parts = _select_parts(headers, channels.part)
    parts.sort(key=lambda each: (each.is_deep, f"{each.name}.".startswith(COMPOSITE)))
    in_layer = [
        [f"{channels.layer}{name[1:]}" if name.startswith("*.") else name for name in names]
        for names in channels.alternatives
        if channels.layer
    ]
    for names in (*in_layer, *channels.alternatives):
        for header in parts:  # the order of the file decides
            found = [_find_channel(path, header, name) for name in names]
            if all(found):
                return header, [name for name in found if name]
    return None


def _select_parts(headers: Sequence[ExrHeader], part: str) -> list[ExrHeader]:
    """The parts with this name, or that match this pattern, in any case; all for an empty one."""
    named = [header for header in headers if header.name == part]
    matching = [each for each in headers if not part or fnmatchcase(each.name, part)]
    return named or matching or [e for e in headers if fnmatchcase(e.name.lower(), part.lower())]


def _find_channel(path: Path, header: ExrHeader, pattern: str) -> str | None:
    """The only channel that a pattern matches, or None. Raises SourceError for several."""
    names = _full(header)
    aliases = {f"{header.name}.{name}": name for name in names} | {name: name for name in names}
    if pattern in aliases:
        return aliases[pattern]
    letter = pattern[2:].upper() if pattern.startswith("*.") else None
    found = {name for name in names if name.upper() == letter}
    if not found:
        found = {name for alias, name in aliases.items() if fnmatchcase(alias, pattern)}
    if not found:  # in any case
        lower = pattern.lower()
        found = {name for alias, name in aliases.items() if fnmatchcase(alias.lower(), lower)}
    if len(found) > 1:
        found = {name for name in found if not name.startswith(COMPOSITE)} or found
    if len(found) > 1:
        layer = min(found)[: 1 - len(pattern)] if pattern.startswith("*.") else ""
        raise SourceError(
            f"{path}: '{pattern}' matches several channels: {', '.join(sorted(found))}; "
            f"name one of them in `channels`, or a `part`{f', or --layer {layer!r}' * bool(layer)}"
        )
    return next(iter(found), None)


def _full(header: ExrHeader) -> list[str]:
    return [name for name, channel in header.channels.items() if channel.is_full]


def read_png(path: Path, modes: Sequence[str] = ("RGB",)) -> NDArray[np.uint8]:
    """A PNG of one of Pillow's `modes` as RGB [h w 3], without alpha. Raises SourceError.

    Pillow has no 16-bit RGB mode, and reads the upper 8 bits, as do others through it.
    """
    with _convert_errors(path), Image.open(path, formats=("PNG",)) as image:
        check_size(path, image.height, image.width)
        if image.mode not in modes:
            expected = ", ".join(modes)
            raise SourceError(f"{path} is a PNG of mode {image.mode}, expected {expected}")
        return np.array(image.convert("RGB"))


def png_size(path: Path) -> tuple[int, int]:
    """Height and width of a PNG, pixels. Raises SourceError."""
    with _convert_errors(path), Image.open(path, formats=("PNG",)) as image:
        return check_size(path, image.height, image.width)


@contextmanager
def _convert_errors(path: Path) -> Iterator[None]:
    """Raise errors of the decoders as SourceError."""
    try:
        yield
    except SourceError:
        raise
    except DeepImageError as error:
        raise SourceError(f"{path} is a deep image; flatten it first") from error
    except (
        *(OSError, RuntimeError, ValueError, KeyError, SyntaxError),
        Image.DecompressionBombError,
    ) as error:
        raise SourceError(f"{path} cannot be decoded, truncated or corrupt ({error})") from error
