"""Clips on disk: open a folder; only the buffers and samples that are used are decoded."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import islice
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from numpy.typing import NDArray
from torch import Tensor

from rlbench.clips.decode_cache import DecodeCache, decode_images
from rlbench.clips.digest import clip_digest
from rlbench.clips.frame_files import exr_path, file_kinds, image_names
from rlbench.clips.header import FILE, ClipError, Header, read_header
from rlbench.frames import BUFFERS, Frame, GBuffer, Pool, Reference, Size, StoredPool

MAX_FILES = 10_000  # that are looked at in a folder without a clip, so that the error comes at once
FRAMES = (".exr", ".pfm", ".zip")  # files from which rlbench import makes clips
DEFAULT_INPUTS = frozenset(BUFFERS)
FULL_WINDOW = (slice(None), slice(None))


class StoredReference(Reference):
    """Half references that are read when they are first used: a clock of methods uses none."""

    _read_half: Callable[[str], Tensor]

    def __init__(self, read_half: Callable[[str], Tensor]) -> None:
        """`read_half` reads half "A" or "B", [1 3 h w]."""
        object.__setattr__(self, "_read_half", read_half)

    @cached_property
    def half_a(self) -> Float[Tensor, "n 3 h w"]:
        """Half "A" of the reference."""
        return self._read_half("A")

    @cached_property
    def half_b(self) -> Float[Tensor, "n 3 h w"]:
        """Half "B" of the reference."""
        return self._read_half("B")


@dataclass(frozen=True)
class StoredClip:
    """A clip folder, read frame by frame as it is iterated. Its radiance is exposed."""

    arrays: DecodeCache
    inputs: frozenset[str]  # buffers that are read
    max_samples: int  # samples per pixel that can be drawn
    pool: str  # kind of the pool that is read
    seed: int  # of the sample order and of rounding
    device: torch.device

    @property
    def header(self) -> Header:
        """The fields of clip.toml."""
        return self.arrays.header

    @property
    def name(self) -> str:
        """The clip's name."""
        return self.header.name

    @property
    def scene(self) -> str:
        """The name of the scene."""
        return self.header.scene

    @property
    def size(self) -> Size:
        """One clip, and height and width of its images."""
        return Size(1, self.header.height, self.header.width)

    @property
    def digest(self) -> str:
        """Content hash of the files and of the header fields that decide pixels."""
        return self.arrays.digest

    def __len__(self) -> int:
        """Number of frames."""
        return self.header.frames

    def __iter__(self) -> Iterator[Frame]:
        """Frames in order. Each is decoded when it is reached."""
        return (self.frame(index) for index in range(len(self)))

    def frame(self, index: int, window: tuple[slice, slice] = FULL_WINDOW) -> Frame:
        """Frame `index`, or a window (rows, columns) of it, as float32 on the device."""
        order, rounding_seed = sample_order(self.seed, self.name, index, self.header.pool_spp)
        stored = self.arrays.pool(self.pool, index, order[: self.max_samples])
        samples = [torch.from_numpy(sample[:, *window]) for sample in stored]
        size = (1, len(samples), *samples[0].shape)
        radiance = torch.empty(size, dtype=torch.float32, device=self.device)
        for slot, sample in enumerate(samples):
            radiance[0, slot] = sample  # from half floats, in one pass
        radiance.mul_(self.header.exposure)
        return self.frame_with_pool(index, StoredPool(radiance, (rounding_seed,)), window)

    def frame_with_pool(
        self, index: int, pool: Pool, window: tuple[slice, slice] = FULL_WINDOW
    ) -> Frame:
        """Frame `index` with another pool; no stored sample is read."""
        gbuffer = self.arrays.gbuffer(index, sorted(self.inputs))
        return Frame(
            index,
            GBuffer({k: self._tensor(v, window) for k, v in gbuffer.items()}, self.header.static),
            pool,
            StoredReference(lambda half: self._half_reference(half, index, window)),
        )

    def _half_reference(self, half: str, index: int, window: tuple[slice, slice]) -> Tensor:
        return self._tensor(self.arrays.reference(half, index), window).mul_(self.header.exposure)

    def _tensor(self, array: NDArray[np.floating], window: tuple[slice, slice]) -> Tensor:
        """An array [c h w] as a tensor [1 c h w], copied out of the memory map."""
        pixels = torch.from_numpy(array[:, *window])
        return pixels.to(self.device, torch.float32, copy=True)[None]


def open_clip(
    folder: Path | str,
    inputs: frozenset[str] = DEFAULT_INPUTS,
    max_samples: int = 8,
    pool: str = "path",
    seed: int = 0,
    device: torch.device | str = "cpu",
    limit_frames: int | None = None,
) -> StoredClip:
    """Open a finished clip. Only the buffers and samples that are used are decoded.

    Args:
        folder: folder of the clip.
        inputs: buffers to read; motion is left out if the clip is static.
        max_samples: samples per pixel that can be drawn, at most as many as are stored.
        pool: kind of the sample pool.
        seed: seed of the sample order and of rounding.
        device: device of the tensors.
        limit_frames: the clip ends after so many frames; its digest is that of these alone.

    Raises:
        ClipError: where the folder is not a finished clip, a file is missing, or the clip does not
            have the buffers or the pool.
    """
    folder = Path(folder)
    header = read_header(folder).first(limit_frames)
    if header.static:
        inputs -= {"motion"}
    if missing := sorted(inputs - set(header.buffers)):
        raise ClipError(
            f"clip {folder} has no buffer {', '.join(missing)}; it has: {', '.join(header.buffers)}"
        )
    if pool not in header.pools:
        raise ClipError(f"clip {folder} has no pool '{pool}'; it has: {', '.join(header.pools)}")
    if max_samples < 1:
        raise ClipError(f"max_samples is {max_samples} for clip {folder}; it must be at least 1")
    arrays = DecodeCache(folder, header, clip_digest(folder, header, pool))
    return StoredClip(
        arrays, inputs, min(max_samples, header.pool_spp), pool, seed, torch.device(device)
    )


def sample_order(seed: int, name: str, index: int, pool_spp: int) -> tuple[list[int], int]:
    """The order in which the stored samples of a frame are drawn, and its rounding seed.

    Both are hashes, so they are equal on all machines and with all versions of numpy.
    """

    def hash_of(purpose: str) -> int:
        key = f"{seed}/{name}/{index}/{purpose}".encode()
        return int.from_bytes(hashlib.blake2b(key, digest_size=8).digest())

    return sorted(range(pool_spp), key=lambda slot: hash_of(f"slot {slot}")), hash_of("ties") >> 33


def verify(folder: Path | str) -> list[str]:
    """Read all files of a clip folder and list every problem; the list of a valid clip is empty."""
    folder = Path(folder)
    try:
        header = read_header(folder)
    except ClipError as error:
        return [str(error)]
    problems = []
    for kind in file_kinds(header.pools):
        for index in range(header.frames):
            try:
                decode_images(exr_path(folder, kind, index), image_names(header, kind), header)
            except ClipError as error:
                problems.append(str(error))
    return problems


def find_clips(folder: Path) -> list[Path]:
    """The clip folders at or directly below a folder. Raises ClipError where there is none."""
    clips = [file.parent for file in sorted([*folder.glob(FILE), *folder.glob(f"*/{FILE}")])]
    if not clips:
        raise ClipError(f"no clip in {folder}; a clip is a folder that contains {FILE}")
    return clips


def find_all_clips(folders: Iterable[Path | str]) -> list[Path]:
    """The clip folders at or directly below each of these folders.

    Raises ClipError for a folder that does not exist, and for one without a clip; the message says
    whether it holds frames to import.
    """
    return [clip for folder in folders for clip in _find(Path(folder))]


def _find(folder: Path) -> list[Path]:
    if not folder.is_dir():
        what = "is a file" if folder.exists() else "does not exist"
        raise ClipError(f"{folder} {what}. Name a folder that holds clips: each has a {FILE}")
    try:
        return find_clips(folder)
    except ClipError as error:
        if deeper := _parents_of_clips(folder):
            raise ClipError(
                f"{folder} holds clips further down. Name the folders that hold them: "
                f"{', '.join(deeper)}"
            ) from error
        if name := next(_frames(folder), ""):
            raise ClipError(
                f"{folder} holds {name} files and no clip. To make clips of them: "
                f"rlbench import {folder} --layout NAME --out FOLDER; to find the layout: "
                f"rlbench lint --guess {folder}"
            ) from error
        raise


def _parents_of_clips(folder: Path) -> list[str]:
    """The folders below that hold clips, sorted."""
    files = islice(folder.rglob("*"), MAX_FILES)
    return sorted({str(file.parents[1]) for file in files if file.name == FILE})


def _frames(folder: Path) -> Iterator[str]:
    files = islice(folder.rglob("*"), MAX_FILES)
    return (file.suffix[1:].upper() for file in files if file.suffix.lower() in FRAMES)
