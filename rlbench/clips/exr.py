"""Read and write one OpenEXR file by channel name.

The OpenEXR library ends the process where a name is not UTF-8, and permutes the channels of a list
that is not sorted. So the header is read and checked here: magic number, version, attributes,
channels, windows. The library decodes the pixels alone.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import OpenEXR
from numpy.typing import NDArray

from rlbench.clips.exr_attributes import BY_LIBRARY, hide_attributes
from rlbench.clips.header import MAX_PIXELS, ClipError
from rlbench.clips.primaries import Chromaticities, find_chromaticities, format_chromaticities
from rlbench.errors import RlbenchError
from rlbench.system.paths import atomic_write, write_error

FLOATS: dict[str, type[np.floating]] = {"HALF": np.float16, "FLOAT": np.float32}
DTYPES: dict[str, type[np.number]] = FLOATS | {"UINT": np.uint32}
MAGIC, VERSION = b"v/1\x01", 2
TILED, LONG_NAMES, DEEP, MULTI_PART = 0x200, 0x400, 0x800, 0x1000  # flags
PART_TYPES = {  # of a multi-part file: its flags
    b"scanlineimage": 0,
    b"tiledimage": TILED,
    b"deepscanline": DEEP,
    b"deeptile": DEEP | TILED,
}
MAX_PARTS = 256
MAX_NAME, MAX_LONG_NAME = 31, 255  # bytes
MAX_CHANNELS = 4096
MAX_COORDINATE = 2**30  # of the data window, so that differences are 32-bit
MAX_IMAGE_BYTES = 2**34  # of all channels, unpacked
CHUNK_BYTES = 16  # the least that a chunk takes: an offset in the table, a line number and a size
PIXEL_TYPES = {0: "UINT", 1: "HALF", 2: "FLOAT"}
CHUNK_LINES = (  # by compression, as in the format; the last are HTJ2K, LJ2K and ZSTD
    *(1, 1, 1, 16, 32, 16, 32, 32, 32, 256, 256, 32, 256, 32),
)
VALUE_BYTES = {  # attributes that decide pixels: type and size
    "channels": ("chlist", None),
    "compression": ("compression", 1),
    "dataWindow": ("box2i", 16),
    "displayWindow": ("box2i", 16),
    "lineOrder": ("lineOrder", 1),
}
TILES = ("tiledesc", 9)
PART_BYTES = {"name": ("string", None), "type": ("string", None)}  # of a multi-part file
COLOUR_BYTES = {"chromaticities": ("chromaticities", 32), "colorInteropID": ("string", None)}

Window = tuple[int, int, int, int]  # first x, first y, last x, last y; pixels


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
    """The channels `names` as [c h w], in the highest precision among them.

    Raises ClipError as `read_channels` does.
    """
    return np.stack(read_channels(path, names, height, width))


def read_channels(
    path: Path, names: Sequence[str], height: int, width: int
) -> list[NDArray[np.floating]]:
    """The channels `names`, each [h w] in the precision that it has in the file.

    Only these channels are unpacked, though OpenEXR decompresses whole chunks with all their
    channels. Raises ClipError where the file is missing, broken, of another size, or has no such
    channel.
    """
    if not path.is_file():
        raise ClipError(f"{path} is missing; `rlbench render` restores missing frames")
    try:
        header = read_exr_header(path)
        _check(path, header, names, height, width)
        return read_planes(path, header, names)
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
    try:
        return _decode_planes(path, header, names)
    except BY_LIBRARY:
        with hide_attributes(path) as (copy, _):  # damage of pixels is found once more
            return _decode_planes(copy, header, names)


def _decode_planes(path: Path, header: ExrHeader, names: Sequence[str]) -> list[NDArray[Any]]:
    if not header.is_part:
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
    if primaries := header.primaries:
        raise ClipError(
            f"{path} has the chromaticities {format_chromaticities(primaries)}; the images of a "
            "clip have those of Rec. 709. Convert it, or import its source: rlbench import"
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


class ExrHeaderError(RlbenchError, ValueError):
    """A file that is not a readable OpenEXR image; the message says why."""


class DeepImageError(ExrHeaderError):
    """An image with a list of samples in each pixel."""

    def __init__(self) -> None:
        """The message says what helps."""
        super().__init__("it is a deep image; flatten it first")


@dataclass(frozen=True)
class Channel:
    """A channel in the list of a file."""

    pixel_type: str  # HALF, FLOAT or UINT
    x_sampling: int  # 1: a value in every column
    y_sampling: int  # 1: a value in every row

    @property
    def is_full(self) -> bool:
        """Whether the channel has a value in every pixel."""
        return self.x_sampling == self.y_sampling == 1

    @property
    def is_float(self) -> bool:
        """Whether the channel is half or float with a value in every pixel."""
        return self.pixel_type != "UINT" and self.is_full


@dataclass(frozen=True)
class ExrHeader:
    """The part of a header that decides the arrays."""

    channels: dict[str, Channel]  # by name, sorted
    data_window: Window  # of the pixels in the file
    display_window: Window  # of the image
    is_part: bool = False  # of a multi-part file
    name: str = ""  # of the part
    is_deep: bool = False
    chromaticities: Chromaticities | None = None  # as the file has them, see `primaries`
    colour_space: str = ""  # its colorInteropID

    @property
    def primaries(self) -> Chromaticities | None:
        """What R, G and B mean; None for Rec. 709. Raises ExrHeaderError where that is unclear."""
        try:
            return find_chromaticities(self.chromaticities, self.colour_space)
        except ValueError as error:
            raise ExrHeaderError(str(error)) from error

    @property
    def size(self) -> tuple[int, int]:
        """Height and width of the data window, pixels."""
        return window_size(self.data_window)

    @property
    def display_size(self) -> tuple[int, int]:
        """Height and width of the display window, pixels."""
        return window_size(self.display_window)


def read_exr_header(path: Path) -> ExrHeader:
    """The header of a single-part image of scan lines or tiles.

    Raises ExrHeaderError where the library could not read the file safely, and OSError where the
    file cannot be opened.
    """
    with path.open("rb") as file:
        size = os.fstat(file.fileno()).st_size
        if not size:
            raise ExrHeaderError("it is empty")
        flags = _read_flags(file)
        if flags & MULTI_PART:
            raise ExrHeaderError("it has several parts; only single-part images are read")
        attributes = _read_attributes(file, size, flags)
        return _check_header(attributes, flags, size - file.tell())


def read_exr_parts(path: Path) -> list[ExrHeader]:
    """The headers of all parts of an image; a single-part image has one.

    A part may be deep. Raises ExrHeaderError and OSError as `read_exr_header` does.
    """
    with path.open("rb") as file:
        flags = _read_flags(file)
        if not flags & MULTI_PART:
            return [read_exr_header(path)]
        size = os.fstat(file.fileno()).st_size
        headers: list[ExrHeader] = []
        while (following := _read(file, 1)) != b"\0":
            file.seek(-len(following), os.SEEK_CUR)
            attributes = _read_attributes(file, size, flags)
            if attributes["type"] not in PART_TYPES or len(headers) >= MAX_PARTS:
                raise ExrHeaderError(
                    f"it has more than {MAX_PARTS} parts, or one of type {attributes['type']!r}"
                )
            kind = PART_TYPES[attributes["type"]]
            if kind & TILED and "tiles" not in attributes:
                raise ExrHeaderError("a part of tiles has no attribute tiles")
            header = _check_header(attributes, kind, size - file.tell())
            name = _text(attributes["name"])
            if name in (each.name for each in headers):
                raise ExrHeaderError(f"it has two parts named '{name}'")
            headers.append(replace(header, is_part=True, name=name, is_deep=bool(kind & DEEP)))
        return [_share_colours(header, headers) for header in headers]


def _share_colours(header: ExrHeader, parts: Sequence[ExrHeader]) -> ExrHeader:
    """The header of a part; what it does not say of colours is as in the first that does."""
    if header.chromaticities or header.colour_space:
        return header
    first = next((each for each in parts if each.chromaticities or each.colour_space), header)
    return replace(header, chromaticities=first.chromaticities, colour_space=first.colour_space)


def _read_flags(file: BinaryIO) -> int:
    if (magic := file.read(4)) != MAGIC:
        raise ExrHeaderError(f"it begins with {magic!r}, an OpenEXR file with {MAGIC!r}")
    (version,) = struct.unpack("<I", _read(file, 4))
    flags: int = version & ~0xFF
    if flags & DEEP and not flags & MULTI_PART:
        raise DeepImageError
    if version & 0xFF != VERSION or flags & ~(TILED | LONG_NAMES | DEEP | MULTI_PART):
        raise ExrHeaderError(
            f"its version field is {version:#x}; only images of version {VERSION} are read"
        )
    return flags


def _read_attributes(file: BinaryIO, size: int, flags: int) -> dict[str, bytes]:
    """The values of the attributes that decide pixels, by name; others are skipped."""
    longest = MAX_LONG_NAME if flags & LONG_NAMES else MAX_NAME
    needed = VALUE_BYTES | ({"tiles": TILES} if flags & TILED else {})
    needed |= PART_BYTES if flags & MULTI_PART else {}
    used = needed | COLOUR_BYTES | ({"tiles": TILES} if flags & MULTI_PART else {})
    seen: set[str] = set()
    values: dict[str, bytes] = {}
    while name := _read_name(file, longest):
        type_name = _read_name(file, longest)
        (count,) = struct.unpack("<i", _read(file, 4))
        if name in seen or not 0 <= count <= size - file.tell():
            raise ExrHeaderError(f"attribute {name} is there twice, or claims {count} bytes")
        seen.add(name)
        if name not in used:
            file.seek(count, os.SEEK_CUR)
            continue
        if used[name] not in ((type_name, count), (type_name, None)):
            raise ExrHeaderError(f"attribute {name} is {count} bytes of type '{type_name}'")
        values[name] = _read(file, count)
    if missing := sorted(needed.keys() - values.keys()):
        raise ExrHeaderError(f"it has no attribute {', '.join(missing)}")
    return values


def _check_header(attributes: dict[str, bytes], flags: int, remaining: int) -> ExrHeader:
    """The header, if its parts agree with each other and with the `remaining` bytes of the file."""
    windows = [_window(name, attributes[name]) for name in ("dataWindow", "displayWindow")]
    stored = attributes.get("chromaticities")
    header = ExrHeader(
        _read_channels(attributes["channels"]),
        windows[0],
        windows[1],
        chromaticities=struct.unpack("<8f", stored) if stored else None,
        colour_space=attributes.get("colorInteropID", b"").decode("ascii", "replace"),
    )
    height, width = header.size
    pixel_bytes = sum(2 if c.pixel_type == "HALF" else 4 for c in header.channels.values())
    if height * width > MAX_PIXELS:
        raise ExrHeaderError(
            f"it claims to be {width} x {height} pixels; from 1 to {MAX_PIXELS} are read"
        )
    if height * width * pixel_bytes > MAX_IMAGE_BYTES:
        raise ExrHeaderError(
            f"it claims {height * width * pixel_bytes} bytes of pixels; at most {MAX_IMAGE_BYTES} "
            "are read"
        )
    (compression,) = attributes["compression"]
    if compression >= len(CHUNK_LINES):
        raise ExrHeaderError(f"its compression is {compression}, which is unknown")
    chunk_h, chunk_w = CHUNK_LINES[compression], width
    if flags & TILED:
        chunk_w, chunk_h = struct.unpack("<II", attributes["tiles"][:8])
    chunks = -(-height // max(chunk_h, 1)) * -(-width // max(chunk_w, 1))
    if chunk_h < 1 or chunk_w < 1 or chunks * CHUNK_BYTES > remaining:
        raise ExrHeaderError(
            f"it claims {width} x {height} pixels, which need {chunks} chunks; the {remaining} "
            "bytes after its header are too few"
        )
    return header


def window_size(window: Window) -> tuple[int, int]:
    """Height and width of a window, pixels."""
    x_min, y_min, x_max, y_max = window
    return y_max - y_min + 1, x_max - x_min + 1


def _window(name: str, value: bytes) -> Window:
    x_min, y_min, x_max, y_max = struct.unpack("<4i", value)
    window = (x_min, y_min, x_max, y_max)
    if x_min > x_max or y_min > y_max or max(map(abs, window)) > MAX_COORDINATE:
        raise ExrHeaderError(f"its {name} is {window}")
    return window


def _read_channels(value: bytes) -> dict[str, Channel]:
    """The channel list, which must be sorted: the library expects pixels in that order."""
    channels: dict[str, Channel] = {}
    before = b""
    while value[:1] != b"\0":
        name, terminator, rest = value.partition(b"\0")
        if not terminator or len(rest) < 17 or not before < name or len(channels) >= MAX_CHANNELS:
            raise ExrHeaderError(
                f"its channel list breaks off, is not sorted, or has more than {MAX_CHANNELS}"
            )
        number, x_sampling, y_sampling = struct.unpack("<i4x2i", rest[:16])
        if number not in PIXEL_TYPES or min(x_sampling, y_sampling) < 1:
            raise ExrHeaderError(f"its channel {name!r} is of an unknown type or sampling")
        channels[_text(name)] = Channel(PIXEL_TYPES[number], x_sampling, y_sampling)
        before, value = name, rest[16:]
    if value != b"\0":
        raise ExrHeaderError("its channel list goes on after its end")
    return channels


def _read_name(file: BinaryIO, longest: int) -> str:
    """A name up to its zero byte, empty at the end of a list."""
    name = b""
    while (byte := _read(file, 1)) != b"\0":
        name += byte
        if len(name) > longest:
            raise ExrHeaderError(f"a name in it is longer than {longest} bytes: {name!r}")
    return _text(name)


def _text(name: bytes) -> str:
    try:
        return name.decode("utf-8")
    except UnicodeDecodeError:
        raise ExrHeaderError(f"a name in it is not UTF-8: {name!r}") from None


def _read(file: BinaryIO, count: int) -> bytes:
    value = file.read(count)
    if len(value) < count:
        raise ExrHeaderError("it ends within its header")
    return value
