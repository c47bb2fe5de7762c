"""Decode cache: each EXR image is decoded once, then read as a memory-mapped array.

An array is a .npy file that ends in its size and checksum, so damage is noticed. numpy and other
readers ignore what follows the values. The checksum of a file is computed once per process, and
again where the file changed; type, shape and size are checked on every opening.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rlbench.clips.exr import read_channels
from rlbench.clips.frame_files import (
    channel_names,
    exceeds_float,
    exr_path,
    is_no_reference,
    nonfinite_mask,
)
from rlbench.clips.header import BUFFER_CHANNELS, ClipError, Header
from rlbench.system import code_hash, paths

TRAILER = struct.Struct("<8sQI")  # magic, bytes before the trailer, their crc32
MAGIC = b"rlbcrc01"
BLOCK_BYTES = 2**22  # that are read at once
TYPES = (np.float16, np.float32)
MAX_MAPS = 2**12  # that are kept open; Linux allows a process 65530
Arrays = Mapping[str, NDArray[np.floating]]  # by image name, each [c h w], float16 or float32


@dataclass(frozen=True)
class DecodeCache:
    """Arrays of one clip folder. They are decoded on first use and kept in the cache folder."""

    folder: Path
    header: Header
    digest: str

    def gbuffer(self, index: int, buffers: Sequence[str]) -> Arrays:
        """The G-buffer of a frame: the named buffers, each [c h w]."""
        return self._load("view", index, buffers)

    def pool(self, kind: str, index: int, slots: Sequence[int]) -> list[NDArray[np.floating]]:
        """The stored samples of a frame in these slots, each [3 h w]."""
        names = [f"s{slot}" for slot in slots]
        return list(self._load(f"pool.{kind}", index, names).values())

    def reference(self, half: str, index: int) -> NDArray[np.floating]:
        """Half "A" or "B" of the reference of a frame, [3 h w]."""
        return self._load(f"reference{half}", index, ["rgb"])["rgb"]

    def _load(self, kind: str, index: int, names: Sequence[str]) -> Arrays:
        """Images by name. Those that the cache lacks, or holds damaged, are decoded together."""
        files = {name: self._cache_file(kind, index, name) for name in names}
        cached = {name: open_array(path, self._shape(name)) for name, path in files.items()}
        if missing := [name for name, array in cached.items() if array is None]:
            decoded = decode_images(exr_path(self.folder, kind, index), missing, self.header)
            for name, array in decoded.items():
                write_array(files[name], array)
                cached[name] = open_array(files[name], array.shape)
        arrays = {name: array for name, array in cached.items() if array is not None}
        if lost := sorted(files.keys() - arrays.keys()):
            raise ClipError(
                f"{files[lost[0]]} was written and cannot be read back; the disk of "
                f"{paths.decoded_folder()} may be failing. Set RLBENCH_CACHE to another folder"
            )
        return arrays

    def _shape(self, name: str) -> tuple[int, int, int]:
        """Channels, height and width of an image."""
        return len(channel_names([name])), self.header.height, self.header.width

    def _cache_file(self, kind: str, index: int, name: str) -> Path:
        folder = paths.decoded_folder() / f"{self.digest}-{_decoder_hash()}" / kind
        return folder / f"{name}.{index:04d}.npy"


@cache
def _decoder_hash() -> str:
    """Hash of the decoding code, so that arrays decoded by other code are not read."""
    names = ("exr", "frame_files")
    modules = [__name__, *(f"rlbench.clips.{name}" for name in names)]
    return code_hash.code_hash(modules, core=())[:8]


def decode_images(path: Path, names: Sequence[str], header: Header) -> Arrays:
    """The named images of one EXR file, each [c h w].

    Raises ClipError where the file is missing, broken, of another size or holds values that are
    not finite, or radiance that is not once it is exposed; depth may be +inf, for background.
    """
    planes = iter(read_channels(path, channel_names(names), header.height, header.width))
    arrays = {n: np.stack([next(planes) for _ in channel_names([n])]) for n in names}
    for name, array in arrays.items():
        may_lack = name == "rgb" and "no reference" in header.limitations
        if may_lack and is_no_reference(array):
            continue
        if count := int(nonfinite_mask(name, array).sum()):
            raise ClipError(
                f"{path}: {count} of {array.size} values of {name} are not finite; "
                "delete the file and run `rlbench render` to trace that frame again"
            )
        if name not in BUFFER_CHANNELS and exceeds_float(array, header.exposure):
            raise ClipError(
                f"{path}: {name} has {np.abs(array).max():g}, which exceeds float32 at exposure "
                f"{header.exposure:g}; correct the exposure in clip.toml, or trace that frame again"
            )
    return arrays


def write_array(path: Path, array: NDArray[np.floating]) -> None:
    """Write an array with its checksum atomically. Raises `rlbench.system.paths.WriteError`."""
    with paths.cache_write(path) as temporary, temporary.open("wb") as file:
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
