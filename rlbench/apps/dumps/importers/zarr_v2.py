"""Read zarr 2 arrays from a zip, and only the chunks that are used.

Read by hand because zarr itself does not limit what an untrusted file may unpack, and its releases
2 and 3 are incompatible. The format is a JSON document beside numbered chunks, so zipfile, json
and numcodecs suffice. The metadata is checked before use, and a chunk is unpacked into a buffer of
its own size, so it cannot take more memory.
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

from rlbench.apps.dumps.importers.limits import MAX_ARRAY_BYTES
from rlbench.errors import SourceError

CODECS = ("lz4", "zstd", "blosc")  # none of these writes past the buffer that it is given
MAX_CHUNKS = 100_000
MAX_METADATA_BYTES = 2**16  # of a .zarray
MAX_RATIO = 256  # of an array to its archive: lz4 reaches 255, rendered noise less than 10
SMALL_BYTES = 2**24  # that any archive may unpack to
CHUNK_OVERHEAD_BYTES = 2**16  # by which incompressible data may grow


@dataclass(frozen=True)
class ZarrMetadata:
    """The fields of a .zarray file."""

    shape: tuple[int, ...]
    chunks: tuple[int, ...]  # shape of a chunk
    dtype: np.dtype[Any]
    order: str  # of the values in a chunk, C or F
    separator: str  # between the numbers in the name of a chunk
    fill: float  # value of absent chunks
    codec: Any  # a codec of numcodecs, or None

    @property
    def chunk_bytes(self) -> int:
        """Size of one unpacked chunk; chunks that exceed the array have the same size."""
        return math.prod(self.chunks) * self.dtype.itemsize

    @property
    def chunk_counts(self) -> list[int]:
        """Number of chunks along each axis."""
        return [-(-n // c) for n, c in zip(self.shape, self.chunks, strict=True)]


def read_metadata(archive: zipfile.ZipFile, key: str) -> ZarrMetadata:
    """The metadata of an array, checked. Raises SourceError."""
    label = f"{archive.filename}, array '{key}'"
    metadata = _parse_metadata(label, _read_entry(archive, f"{key}/.zarray", MAX_METADATA_BYTES))
    shape, chunks = metadata.shape, metadata.chunks
    if metadata.dtype.kind not in "uif":
        raise SourceError(f"{label} is of type {metadata.dtype}; only numbers are read")
    if len(shape) != len(chunks) or not 1 <= len(shape) <= 8 or min(*shape, *chunks) < 1:
        raise SourceError(f"{label} has shape {shape} in chunks of {chunks}")
    if metadata.chunk_bytes > MAX_ARRAY_BYTES or math.prod(metadata.chunk_counts) > MAX_CHUNKS:
        raise SourceError(
            f"{label} claims chunks of {metadata.chunk_bytes} bytes for a shape of {shape}; at "
            f"most {MAX_ARRAY_BYTES} bytes per chunk and {MAX_CHUNKS} chunks are read"
        )
    return metadata


def _parse_metadata(label: str, text: bytes) -> ZarrMetadata:
    """A .zarray document whose values are not checked yet, except for the format's version."""
    try:
        document = json.loads(text)
        shape, chunks = (tuple(map(int, document[name])) for name in ("shape", "chunks"))
        dtype = np.dtype(document["dtype"])
        fill = float(document.get("fill_value") or 0)
        order = document.get("order", "C")
        separator = document.get("dimension_separator", ".")
        version, filters, compressor = (
            document.get(k) for k in ("zarr_format", "filters", "compressor")
        )
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        raise SourceError(f"{label}: .zarray cannot be understood ({error!r})") from error
    if version != 2 or filters or order not in ("C", "F") or separator not in (".", "/"):
        raise SourceError(f"{label}: expected zarr format 2 without filters; it says {document}")
    return ZarrMetadata(shape, chunks, dtype, order, separator, fill, _codec(label, compressor))


def read_array(archive: zipfile.ZipFile, key: str, last: int | None = None) -> NDArray[Any]:
    """An array, or only the first `last` elements of its last axis. Raises SourceError."""
    metadata = read_metadata(archive, key)
    shape = metadata.shape
    if last is not None:
        shape = (*shape[:-1], min(last, shape[-1]))
    if (size := math.prod(shape) * metadata.dtype.itemsize) > MAX_ARRAY_BYTES:
        raise SourceError(
            f"{archive.filename}, array '{key}' claims {size} bytes; "
            f"at most {MAX_ARRAY_BYTES} are read"
        )
    size = max(size, metadata.chunk_bytes)
    _check_unpacked(archive, f"{archive.filename}, array '{key}'", size)
    chunks = metadata.chunks
    values = np.full(shape, metadata.fill, metadata.dtype)
    for index in product(*(range(-(-n // c)) for n, c in zip(shape, chunks, strict=True))):
        name = f"{key}/{metadata.separator.join(map(str, index))}"
        if name in archive.NameToInfo:
            window = tuple(slice(i * c, (i + 1) * c) for i, c in zip(index, chunks, strict=True))
            part = values[window]
            part[...] = _read_chunk(archive, name, metadata)[tuple(map(slice, part.shape))]
    return values


def read_shapes(archive: zipfile.ZipFile, keys: Sequence[str]) -> dict[str, tuple[int, ...]]:
    """The shapes of arrays, by key; no chunk is unpacked. Raises SourceError."""
    return {key: read_metadata(archive, key).shape for key in keys}


@contextmanager
def open_archive(path: Path) -> Iterator[zipfile.ZipFile]:
    """The zip, opened for reading. Raises SourceError where it is not a zip, or broken."""
    try:
        with zipfile.ZipFile(path) as archive:
            yield archive
    except (zipfile.BadZipFile, OSError, EOFError, NotImplementedError, RuntimeError) as error:
        raise SourceError(f"{path} cannot be read, truncated or corrupt ({error})") from error


def _read_chunk(archive: zipfile.ZipFile, name: str, metadata: ZarrMetadata) -> NDArray[Any]:
    """One chunk, unpacked."""
    size = metadata.chunk_bytes
    packed = _read_entry(archive, name, size + size // 64 + CHUNK_OVERHEAD_BYTES)
    unpacked = bytearray(size)
    if metadata.codec is not None:
        try:
            metadata.codec.decode(packed, out=unpacked)
        except (ValueError, RuntimeError) as error:
            raise SourceError(f"{archive.filename}: {name} cannot be unpacked ({error})") from error
    elif len(packed) == size:
        unpacked[:] = packed
    else:
        raise SourceError(f"{archive.filename}: {name} is {len(packed)} bytes, expected {size}")
    values = np.frombuffer(unpacked, metadata.dtype)
    return values.reshape(metadata.chunks, order="F" if metadata.order == "F" else "C")


def _check_unpacked(archive: zipfile.ZipFile, label: str, size: int) -> None:
    """Raise SourceError where `size` is implausible for the bytes of the whole archive."""
    packed = Path(str(archive.filename)).stat().st_size
    if size > max(SMALL_BYTES, MAX_RATIO * packed):
        raise SourceError(
            f"{label} unpacks to {size} bytes, {size // packed} times the {packed} bytes of the "
            f"file; at most {MAX_RATIO} times are read. If it is genuine, write it uncompressed"
        )


def _read_entry(archive: zipfile.ZipFile, name: str, max_bytes: int) -> bytes:
    """The bytes of an entry that claims at most `max_bytes`; zipfile unpacks no more than that."""
    if name not in archive.NameToInfo:
        content = ", ".join(sorted({entry.split("/")[0] for entry in archive.namelist()})[:24])
        raise SourceError(f"{archive.filename} has no {name}; it has: {content or 'nothing'}")
    if (size := archive.getinfo(name).file_size) > max_bytes:
        raise SourceError(
            f"{archive.filename}: {name} unpacks to {size} bytes; at most {max_bytes} are read"
        )
    return archive.read(name)


def _codec(label: str, compressor: Any) -> Any:
    """The codec of numcodecs that unpacks chunks, or None where they are not packed."""
    if compressor is None:
        return None
    try:
        import numcodecs
    except ImportError as error:
        raise SourceError(
            f"{label} is compressed, which needs numcodecs: pip install 'rlbench[noisebase]'"
        ) from error
    if not isinstance(compressor, dict) or compressor.get("id") not in CODECS:
        raise SourceError(f"{label} is packed by {compressor}; read are: {', '.join(CODECS)}")
    return numcodecs.get_codec({"id": compressor["id"]})  # settings matter for packing only
