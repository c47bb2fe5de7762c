"""Clips on disk: open a folder, and read of it only what is asked for."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from rlbench.clips.decode_cache import DecodeCache, decode
from rlbench.clips.digest import clip_digest
from rlbench.clips.frame_files import exr_path, file_kinds, has_frame, images, write_frame
from rlbench.clips.header import FILE, ClipError, Header, read_header, write_header
from rlbench.clips.in_memory import InMemoryClip
from rlbench.frames import BUFFERS, Frame, GBuffer, Pool, Reference, Size, StoredPool

__all__ = [
    "ClipError",
    "Header",
    "InMemoryClip",
    "StoredClip",
    "has_frame",
    "open_clip",
    "read_header",
    "verify",
    "write_frame",
    "write_header",
]

ALL = frozenset(BUFFERS)
WHOLE = (slice(None), slice(None))


@dataclass(frozen=True)
class StoredClip:
    """A clip folder, read frame by frame as it is iterated. Its radiance is exposed."""

    arrays: DecodeCache
    inputs: frozenset[str]
    max_samples: int  # most samples per pixel that can be bought
    pool: str
    seed: int  # of the order of sale and of rounding
    device: torch.device

    @property
    def header(self) -> Header:
        """What clip.toml says."""
        return self.arrays.header

    @property
    def name(self) -> str:
        """The clip's name."""
        return self.header.name

    @property
    def scene(self) -> str:
        """The scene that it shows."""
        return self.header.scene

    @property
    def size(self) -> Size:
        """One clip and its pixels."""
        return Size(1, self.header.height, self.header.width)

    @property
    def digest(self) -> str:
        """Hash of the files' bytes and of what decides pixels in the header."""
        return self.arrays.digest

    def __len__(self) -> int:
        """Number of frames."""
        return self.header.frames

    def __iter__(self) -> Iterator[Frame]:
        """Frames in order, each decoded when it is reached."""
        return (self.frame(index) for index in range(len(self)))

    def frame(self, index: int, window: tuple[slice, slice] = WHOLE) -> Frame:
        """Frame `index`, or the pixels of it in `window` (rows, columns), float32 on the device."""
        order, key = sample_order(self.seed, self.name, index, self.header.pool_spp)
        stored = self.arrays.pool(self.pool, index, order[: self.max_samples])
        radiance = torch.stack([self._tensor(sample, window) for sample in stored], dim=1)
        return self.frame_with_pool(
            index, StoredPool(radiance * self.header.exposure, (key,)), window
        )

    def frame_with_pool(self, index: int, pool: Pool, window: tuple[slice, slice] = WHOLE) -> Frame:
        """Frame `index` with a pool from elsewhere: no stored sample is read."""
        gbuffer = self.arrays.gbuffer(index, sorted(self.inputs))
        halves = [self._tensor(self.arrays.reference(half, index), window) for half in "AB"]
        exposure = self.header.exposure
        return Frame(
            index,
            GBuffer({k: self._tensor(v, window) for k, v in gbuffer.items()}, self.header.static),
            pool,
            Reference(halves[0] * exposure, halves[1] * exposure),
        )

    def _tensor(self, array: NDArray[np.floating], window: tuple[slice, slice]) -> Tensor:
        """[1 c h w], copied out of the memory map."""
        part = np.array(array[:, *window])
        return torch.from_numpy(part).to(self.device).float()[None]


def open_clip(
    folder: Path | str,
    inputs: frozenset[str] = ALL,
    max_samples: int = 8,
    pool: str = "path",
    seed: int = 0,
    device: torch.device | str = "cpu",
) -> StoredClip:
    """A finished clip, of which only the view buffers `needs` and `slots` samples are decoded.

    At most as many samples as are stored can be sold. Raises ClipError where the folder is not a
    finished clip, lacks a file, or does not have the buffers or the pool.
    """
    folder = Path(folder)
    header = read_header(folder)
    if header.static:
        inputs -= {"motion"}
    if lacking := sorted(inputs - set(header.buffers)):
        raise ClipError(
            f"clip {folder} has no buffer {', '.join(lacking)}; it has: {', '.join(header.buffers)}"
        )
    if pool not in header.pools:
        raise ClipError(f"clip {folder} has no pool '{pool}'; it has: {', '.join(header.pools)}")
    if max_samples < 1:
        raise ClipError(
            f"asked for {max_samples} samples of clip {folder}; at least 1 must be readable"
        )
    arrays = DecodeCache(folder, header, clip_digest(folder, header, pool))
    return StoredClip(
        arrays, inputs, min(max_samples, header.pool_spp), pool, seed, torch.device(device)
    )


def sample_order(seed: int, name: str, index: int, stored: int) -> tuple[list[int], int]:
    """The order in which a frame's stored samples are sold, and the key of rounding its shares.

    Both are hashes, so they are the same on every machine and with every version of numpy.
    """

    def draw(purpose: str) -> int:
        told = f"{seed}/{name}/{index}/{purpose}".encode()
        return int.from_bytes(hashlib.blake2b(told, digest_size=8).digest())

    return sorted(range(stored), key=lambda slot: draw(f"slot {slot}")), draw("ties") >> 33


def verify(folder: Path | str) -> list[str]:
    """Every problem of a clip folder, in words; all of its files are read. Empty if it is sound."""
    folder = Path(folder)
    try:
        header = read_header(folder)
    except ClipError as error:
        return [str(error)]
    problems = []
    for kind in file_kinds(header.pools):
        for index in range(header.frames):
            try:
                decode(exr_path(folder, kind, index), images(header, kind), header)
            except ClipError as error:
                problems.append(str(error))
    return problems


def find_clips(place: Path) -> list[Path]:
    """The clip folders at or directly below a folder. Raises ClipError where there is none."""
    found = [file.parent for file in sorted([*place.glob(FILE), *place.glob(f"*/{FILE}")])]
    if not found:
        raise ClipError(f"no clip in {place}: a clip is a folder with {FILE} in it")
    return found
