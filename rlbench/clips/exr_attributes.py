"""Attributes of an OpenEXR file that decide no pixel: read without the library, and hidden from it.

The library's binding to Python ends with an error at a string that is not UTF-8, an empty list, and
types that it does not know how to read. It keeps attributes of a foreign type as bytes. So in a
copy the type of all that decides no pixel gets another first letter, which is put back afterwards.
"""

from __future__ import annotations

import mmap
import shutil
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

MULTI_PART = 0x1000  # a flag
HIDDEN = b"~"  # the first letter of a hidden type
DECIDING = (
    *("channels", "compression", "dataWindow", "displayWindow", "lineOrder", "pixelAspectRatio"),
    *("screenWindowCenter", "screenWindowWidth", "tiles", "name", "type", "version", "chunkCount"),
    "view",
)
BY_LIBRARY = (OSError, RuntimeError, ValueError, TypeError)  # its errors at attributes


class Attribute(NamedTuple):
    """An attribute in the bytes of a file."""

    part: int
    name: str
    type_start: int  # byte at which its type begins
    type_name: bytes
    value: slice


@contextmanager
def hide_attributes(path: Path) -> Iterator[tuple[Path, dict[tuple[int, str], bytes]]]:
    """A copy of a file for the library to open, and the types that are hidden in it.

    The header of the file must be sound, as `rlbench.clips.exr.read_exr_parts` finds out.
    """
    with TemporaryDirectory(prefix="rlbench-") as folder:
        copy = Path(folder, "copy.exr")
        shutil.copyfile(path, copy)
        hidden = {}
        with copy.open("r+b") as file, mmap.mmap(file.fileno(), 0) as content:
            for each in list(_walk(content)):
                if each.name not in DECIDING and each.type_name:
                    hidden[each.part, each.name] = each.type_name
                    content[each.type_start : each.type_start + 1] = HIDDEN
        yield copy, hidden


def show_attributes(path: Path, hidden: dict[tuple[int, str], bytes]) -> None:
    """Put the types back into a file that was written from such a copy."""
    with path.open("r+b") as file, mmap.mmap(file.fileno(), 0) as content:
        for each in list(_walk(content)):
            if each.type_name.startswith(HIDDEN) and (each.part, each.name) in hidden:
                first = hidden[each.part, each.name][:1]
                content[each.type_start : each.type_start + 1] = first


def read_strings(path: Path) -> list[tuple[str, str]]:
    """Names and values of all strings in the headers of a file."""
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, prot=mmap.PROT_READ) as content:
        return [
            (each.name, content[each.value].decode(errors="replace"))
            for each in _walk(content)
            if each.type_name == b"string"
        ]


def _walk(content: mmap.mmap) -> Iterator[Attribute]:
    """The attributes of all parts."""
    (flags,) = struct.unpack("<I", content[4:8])
    part, at = 0, 8
    while True:
        if content[at] == 0:
            part, at = part + 1, at + 1
            if not flags & MULTI_PART or content[at] == 0:
                return
        type_start = content.find(b"\0", at) + 1
        size_start = content.find(b"\0", type_start) + 1
        (size,) = struct.unpack("<i", content[size_start : size_start + 4])
        name = content[at : type_start - 1].decode(errors="replace")
        at = size_start + 4 + size
        value = slice(size_start + 4, at)
        yield Attribute(part, name, type_start, content[type_start : size_start - 1], value)
