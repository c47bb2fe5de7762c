"""One cached array: a .npy file that ends in its size and checksum, so damage is noticed.

numpy and other readers ignore what follows the values. The checksum of a file is computed once per
process, and again where the file changed; type, shape and size are checked on every opening.
"""

from __future__ import annotations

import os
import struct
import zlib
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rlbench.system.paths import cache_write

__all__ = ["open_array", "write_array"]

TRAILER = struct.Struct("<8sQI")  # magic, bytes before the trailer, their crc32
MAGIC = b"rlbcrc01"
BLOCK_BYTES = 2**22  # that are read at once
TYPES = (np.float16, np.float32)
MAX_MAPS = 2**12  # that are kept open; Linux allows a process 65530


def write_array(path: Path, array: NDArray[np.floating]) -> None:
    """Write an array with its checksum atomically. Raises `rlbench.system.paths.WriteError`."""
    with cache_write(path) as temporary, temporary.open("wb") as file:
        np.lib.format.write_array(file, np.ascontiguousarray(array), allow_pickle=False)
        size = file.tell()
        file.flush()
        file.write(TRAILER.pack(MAGIC, size, _checksum(temporary, size)))


def open_array(path: Path, shape: tuple[int, ...]) -> NDArray[np.floating] | None:
    """The array as a memory map, or None where the file is absent, damaged, or of another shape.

    While the file does not change, all calls share one map. Writing to it does not change the file.
    """
    try:
        stat = path.stat()
        array = _map(path, stat.st_size, stat.st_mtime_ns, stat.st_ino)
    except (OSError, ValueError, EOFError, SyntaxError):
        return None
    has_shape = array is not None and array.shape == shape and array.dtype in TYPES
    return array if has_shape else None


@lru_cache(maxsize=MAX_MAPS)
def _map(path: Path, size: int, mtime_ns: int, inode: int) -> NDArray[np.floating] | None:
    """The array of a file in this state; None if its trailer does not agree with its content."""
    if not _is_intact(path, size, mtime_ns, inode):
        return None
    array: NDArray[np.floating] = np.load(path, mmap_mode="c", allow_pickle=False)
    return array


@lru_cache(maxsize=2**18)
def _is_intact(path: Path, size: int, mtime_ns: int, inode: int) -> bool:
    """Whether the trailer agrees with the content of a file in this state."""
    if size < TRAILER.size:
        return False
    with path.open("rb") as file:
        file.seek(-TRAILER.size, os.SEEK_END)
        magic, stored_size, checksum = TRAILER.unpack(file.read(TRAILER.size))
    if magic != MAGIC or stored_size != size - TRAILER.size:
        return False
    return bool(_checksum(path, stored_size) == checksum)


def _checksum(path: Path, size: int) -> int:
    """The crc32 of the first `size` bytes of a file."""
    checksum = 0
    with path.open("rb", buffering=0) as file:
        while block := file.read(min(BLOCK_BYTES, size)):
            checksum, size = zlib.crc32(block, checksum), size - len(block)
    return checksum
