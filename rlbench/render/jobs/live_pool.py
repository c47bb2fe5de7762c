"""The live pool: a sample is traced when it is bought, and what nobody buys is never traced."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, Int
from numpy import ndarray as Array
from torch import Tensor

from rlbench.clips.exr import precision
from rlbench.clips.frame_files import exr_path
from rlbench.clips.stored import ClipError, StoredClip, read_header, sample_order
from rlbench.frames import Frame, Samples, Size
from rlbench.render.fingerprint import fingerprint
from rlbench.render.jobs.job import POOLS, marked
from rlbench.render.jobs.render_clips import scene_of_clip
from rlbench.render.mitsuba.open_tracer import open_tracer
from rlbench.render.mitsuba.tracer import LANES, Tracer
from rlbench.render.scene import Scene


@dataclass(frozen=True)
class LivePool:
    """A pool of one frame that traces exactly the samples it sells.

    Sample k of a pixel is the one that the clip's stored pool sells as its k-th, rounded and
    exposed as that is: on the machine that rendered the clip they are equal, bit for bit.
    """

    tracer: Tracer
    time: float  # of the frame
    order: tuple[int, ...]  # numbers of the samples, in the order of sale
    key: int  # decides whose share is rounded up
    exposure: float
    stored: type[np.floating]  # precision to which the clip's file rounds radiance
    device: torch.device

    @property
    def size(self) -> Size:
        """One clip and its pixels."""
        return Size(1, self.tracer.height, self.tracer.width)

    @property
    def max_samples(self) -> int:
        """Number of samples that have a place in the order of sale."""
        return len(self.order)

    @property
    def rounding_seeds(self) -> tuple[int, ...]:
        """The frame's key."""
        return (self.key,)

    def empty(self) -> Samples:
        """No samples at all."""
        _, h, w = self.size
        counts = _blank((1, 1, h, w), np.int64).to(self.device)
        return Samples(_blank((1, self.max_samples, 3, h, w), np.float32).to(self.device), counts)

    def read(self, before: Samples, counts: Int[Tensor, "1 1 h w"]) -> Float[Tensor, "1 s 3 h w"]:
        """Radiance of the first `counts` samples of each pixel; what `before` lacks is traced."""
        pixels, slots = _lacking(*(c.flatten().cpu().numpy() for c in (before.counts, counts)))
        values = torch.from_numpy(self._traced(pixels, slots)).to(self.device) * self.exposure
        radiance = self.empty().radiance
        most = int(before.counts.max())  # of one pixel: the slots beyond hold nothing to be copied
        radiance[:, :most] = before.radiance[:, :most]
        row, column = (torch.from_numpy(i) for i in np.divmod(pixels, self.size.w))
        radiance[0].permute(0, 2, 3, 1)[torch.from_numpy(slots), row, column] = values
        return radiance

    def _traced(self, pixels: Int[Array, " n"], slots: Int[Array, " n"]) -> Float[Array, "n 3"]:
        """What the stored pool's file holds of these samples, in float32."""
        if self.tracer.time != self.time:
            self.tracer.set_time(self.time)
        numbers = np.asarray(self.order)[slots]
        radiance = np.zeros((len(pixels), 3), np.float32)
        for start in range(0, len(pixels), LANES):
            part = slice(start, start + LANES)
            radiance[part] = self.tracer.trace(pixels[part], numbers[part])
        held = np.minimum(radiance, np.finfo(self.stored).max)  # of another machine's firefly
        return np.asarray(held.astype(self.stored), np.float32)


@dataclass(frozen=True)
class LiveClip:
    """A rendered clip whose views and references are read, and whose samples are traced."""

    stored: StoredClip
    tracer: Tracer

    @property
    def name(self) -> str:
        """The clip's name."""
        return self.stored.name

    @property
    def scene(self) -> str:
        """The scene that it shows."""
        return self.stored.scene

    @property
    def size(self) -> Size:
        """One clip and its pixels."""
        return self.stored.size

    @property
    def digest(self) -> str:
        """The stored clip's digest."""
        return self.stored.digest

    def __len__(self) -> int:
        """Number of frames."""
        return len(self.stored)

    def __iter__(self) -> Iterator[Frame]:
        """Frames in order, the scene moved to each when it is reached."""
        return (self.frame(index) for index in range(len(self)))

    def frame(self, index: int) -> Frame:
        """Frame `index`, float32 on the clip's device."""
        clip, header = self.stored, self.stored.header
        order, key = sample_order(clip.seed, clip.name, index, header.pool_spp)
        file = exr_path(clip.arrays.folder, f"pool.{clip.pool}", index)
        self.tracer.set_time(float(index))  # also what a renderer does before it traces
        pool = LivePool(
            self.tracer,
            float(index),
            tuple(order[: clip.max_samples]),
            key,
            header.exposure,
            precision(file, "s0.R"),
            clip.device,
        )
        return clip.frame_with_pool(index, pool)


def scene_of(folder: Path) -> Scene:
    """The scene that a clip folder was rendered from, built again.

    Raises ClipError where it was not rendered by `rlbench render`, where the scene is not
    installed, or where it has changed since.
    """
    header = read_header(folder)
    told = f"clip {folder} cannot be sampled live"
    if not (mark := marked(folder)):
        raise ClipError(f"{told}: `rlbench render` did not write it; use --pool stored")
    scene = scene_of_clip(header.name)
    found, wanted = fingerprint(scene, header.frames), mark.split()[0]
    if found != wanted:
        raise ClipError(
            f"{told}: its scene '{header.name}' is now {found}, the clip shows {wanted}; "
            f"render it again, or use --pool stored"
        )
    return scene


def open_live(stored: StoredClip) -> LiveClip:
    """The same clip with a live pool, as far as the stored one can be sold.

    Raises ClipError as `scene_of` does, and for a pool other than `path`.
    """
    if stored.pool not in POOLS:
        raise ClipError(
            f"no live pool '{stored.pool}', whose samples hang on those of earlier frames and of "
            f"neighbours; use --pool stored. Samples are traced for: {', '.join(POOLS)}"
        )
    return LiveClip(stored, _tracer(stored.arrays.folder, stored.digest))


@lru_cache(maxsize=1)
def _tracer(folder: Path, digest: str) -> Tracer:
    """The clip's tracer: one for all methods that run on the clip, and one clip at a time."""
    gc.collect()  # a scene that is still alive makes Dr.Jit compile the next one again
    header = read_header(folder)
    cap = header.radiance_cap / header.exposure
    return open_tracer(scene_of(folder), header.height, header.width, header.seed, cap)


def _blank(shape: tuple[int, ...], kind: type[np.number]) -> Tensor:
    """Zeros whose memory is not there until it is written: torch writes its own at once."""
    return torch.from_numpy(np.zeros(shape, kind))


def _lacking(
    before: Int[Array, " p"], counts: Int[Array, " p"]
) -> tuple[Int[Array, " n"], Int[Array, " n"]]:
    """Pixel and slot of every sample from number `before` up to `counts`, pixel by pixel."""
    more = counts - before
    (where,) = np.nonzero(more > 0)
    many = more[where]
    start = np.cumsum(many) - many  # of each pixel in what is returned
    slots = np.arange(many.sum()) - np.repeat(start - before[where], many)
    return np.repeat(where, many), slots
