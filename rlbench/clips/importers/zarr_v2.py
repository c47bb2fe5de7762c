"""Arrays of format zarr 2 in a zip: of each, only the chunks that are asked for.

The format is a JSON beside numbered chunks, so zipfile, json and numcodecs read it, and no version
of zarr, whose releases 2 and 3 do not agree, has to be installed. What strangers claim in the JSON
is checked before it is believed, and a chunk is unpacked into memory of its own size, never more.
"""

from __future__ import annotations

import json
import math
import zipfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rlbench.clips.importers.limits import MOST_BYTES
from rlbench.clips.importers.sequence import SourceError

CODECS = ("lz4", "zstd", "blosc")  # all refuse to write past the memory that they are given
MOST_CHUNKS = 100_000
MOST_TOLD = 2**16  # bytes of a .zarray
SPARE = 2**16  # bytes by which a chunk that cannot be packed may grow


@dataclass(frozen=True)
class ZarrMetadata:
    """What a .zarray says of its array."""

    shape: tuple[int, ...]
    chunks: tuple[int, ...]
    dtype: np.dtype[Any]
    order: str  # of the values in a chunk, C or F
    separator: str  # between the numbers in a chunk's name
    fill: float  # value of the chunks that are absent
    codec: Any  # of numcodecs, or None

    @property
    def chunk_bytes(self) -> int:
        """Size of one unpacked chunk; those that stick out over the edge are as large."""
        return math.prod(self.chunks) * self.dtype.itemsize


def read_metadata(archive: zipfile.ZipFile, key: str) -> ZarrMetadata:
    """What is said of an array, if it can be so. Raises SourceError."""
    where = f"{archive.filename}, array '{key}'"
    try:
        found = json.loads(_bytes(archive, f"{key}/.zarray", MOST_TOLD))
        shape, chunks = (tuple(map(int, found[name])) for name in ("shape", "chunks"))
        dtype = np.dtype(found["dtype"])
        fill = float(found.get("fill_value") or 0)
        order, separator = found.get("order", "C"), found.get("dimension_separator", ".")
        version, filters, compressor = (
            found.get(k) for k in ("zarr_format", "filters", "compressor")
        )
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        raise SourceError(f"{where}: .zarray cannot be understood ({error!r})") from error
    if version != 2 or filters or order not in ("C", "F") or separator not in (".", "/"):
        raise SourceError(f"{where}: expected zarr format 2 without filters; it says {found}")
    if dtype.kind not in "uif":
        raise SourceError(f"{where} is of type {dtype}; only numbers are read")
    if len(shape) != len(chunks) or not 1 <= len(shape) <= 8 or min(*shape, *chunks) < 1:
        raise SourceError(f"{where} has shape {shape} in chunks of {chunks}")
    described = ZarrMetadata(
        shape, chunks, dtype, order, separator, fill, _codec(where, compressor)
    )
    if described.chunk_bytes > MOST_BYTES or len(list(_range(described))) > MOST_CHUNKS:
        raise SourceError(
            f"{where} claims chunks of {described.chunk_bytes} bytes for a shape of {shape}; at "
            f"most {MOST_BYTES} bytes a chunk and {MOST_CHUNKS} chunks are read"
        )
    return described


def array(archive: zipfile.ZipFile, key: str, last: int | None = None) -> NDArray[Any]:
    """An array, or of its last axis only the first `last`. Raises SourceError."""
    about = read_metadata(archive, key)
    shape = about.shape if last is None else (*about.shape[:-1], min(last, about.shape[-1]))
    if (size := math.prod(shape) * about.dtype.itemsize) > MOST_BYTES:
        raise SourceError(
            f"{archive.filename}, array '{key}' claims {size} bytes; at most {MOST_BYTES} are read"
        )
    values = np.full(shape, about.fill, about.dtype)
    for index in product(*(range(-(-n // c)) for n, c in zip(shape, about.chunks, strict=True))):
        name = f"{key}/{about.separator.join(map(str, index))}"
        if name in archive.NameToInfo:
            corner = [i * c for i, c in zip(index, about.chunks, strict=True)]
            place = tuple(slice(at, at + c) for at, c in zip(corner, about.chunks, strict=True))
            part = values[place]
            part[...] = _chunk(archive, name, about)[tuple(map(slice, part.shape))]
    return values


@contextmanager
def opened(path: Path) -> Iterator[zipfile.ZipFile]:
    """The zip, for reading. Raises SourceError where it is none, or is broken."""
    try:
        with zipfile.ZipFile(path) as archive:
            yield archive
    except (zipfile.BadZipFile, OSError, EOFError, NotImplementedError, RuntimeError) as error:
        raise SourceError(f"{path} cannot be read, truncated or corrupt ({error})") from error


def _range(about: ZarrMetadata) -> Iterator[int]:
    """As many numbers as there are chunks, but no more than is of interest."""
    count = math.prod(-(-n // c) for n, c in zip(about.shape, about.chunks, strict=True))
    return iter(range(min(count, MOST_CHUNKS + 1)))


def _chunk(archive: zipfile.ZipFile, name: str, about: ZarrMetadata) -> NDArray[Any]:
    packed = _bytes(archive, name, about.chunk_bytes + about.chunk_bytes // 64 + SPARE)
    room = bytearray(about.chunk_bytes)
    if about.codec is not None:
        try:
            about.codec.decode(packed, out=room)
        except (ValueError, RuntimeError) as error:
            raise SourceError(f"{archive.filename}: {name} cannot be unpacked ({error})") from error
    elif len(packed) == len(room):
        room[:] = packed
    else:
        raise SourceError(f"{archive.filename}: {name} is {len(packed)} bytes, not {len(room)}")
    values = np.frombuffer(room, about.dtype)
    return values.reshape(about.chunks, order="F" if about.order == "F" else "C")


def _bytes(archive: zipfile.ZipFile, name: str, most: int) -> bytes:
    """An entry's bytes, if it claims no more than `most`, for zipfile unpacks no more than that."""
    if name not in archive.NameToInfo:
        have = ", ".join(sorted({entry.split("/")[0] for entry in archive.namelist()})[:24])
        raise SourceError(f"{archive.filename} has no {name}; it has: {have or 'nothing'}")
    if (size := archive.getinfo(name).file_size) > most:
        raise SourceError(
            f"{archive.filename}: {name} unpacks to {size} bytes; at most {most} are read"
        )
    return archive.read(name)


def _codec(where: str, compressor: Any) -> Any:
    if compressor is None:
        return None
    try:
        import numcodecs
    except ImportError as error:
        raise SourceError(
            f"{where} is compressed, which needs numcodecs: pip install 'rlbench[noisebase]'"
        ) from error
    if not isinstance(compressor, dict) or compressor.get("id") not in CODECS:
        raise SourceError(f"{where} is packed by {compressor}; read are: {', '.join(CODECS)}")
    return numcodecs.get_codec({"id": compressor["id"]})  # settings matter for packing only


def shapes(archive: zipfile.ZipFile, keys: Sequence[str]) -> dict[str, tuple[int, ...]]:
    """The shapes of arrays, of which nothing is unpacked. Raises SourceError."""
    return {key: read_metadata(archive, key).shape for key in keys}
