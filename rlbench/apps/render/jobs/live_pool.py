"""The live pool: samples are traced when a method draws them, and no others are traced."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from rlbench.apps.render.fingerprint import fingerprint
from rlbench.apps.render.jobs.job import FRAME_POOLS, read_content_key, read_whole_length
from rlbench.apps.render.jobs.render_clips import scene_of_header
from rlbench.apps.render.mitsuba.open_tracer import open_tracer
from rlbench.apps.render.mitsuba.tracer import MAX_PATHS, Tracer
from rlbench.apps.render.mitsuba.variant import select_variant
from rlbench.apps.render.scene import Scene
from rlbench.clips.exr import channel_dtype
from rlbench.clips.frame_files import exr_path
from rlbench.clips.header import ClipError, read_header
from rlbench.clips.in_memory import ClipWrapper
from rlbench.clips.stored import StoredClip, sample_order
from rlbench.frames import Frame, Samples, Size


@dataclass(frozen=True)
class LivePool:
    """The pool of one frame, which traces exactly the samples that are drawn.

    Sample k of a pixel equals the k-th sample of the clip's stored pool, rounded and exposed alike:
    on the machine that rendered the clip they are bit-identical.
    """

    tracer: Tracer
    time: float  # of the frame
    sample_order: tuple[int, ...]  # sample numbers, in the order in which they are drawn
    rounding_seed: int  # of the dither that rounds fractional counts
    exposure: float
    stored_dtype: torch.dtype  # of radiance in the clip's file
    device: torch.device

    @property
    def size(self) -> Size:
        """One clip and its pixels."""
        return Size(1, self.tracer.height, self.tracer.width)

    @property
    def max_samples(self) -> int:
        """The number of samples per pixel that can be drawn."""
        return len(self.sample_order)

    @property
    def rounding_seeds(self) -> tuple[int, ...]:
        """The rounding seed of the one clip."""
        return (self.rounding_seed,)

    def empty(self) -> Samples:
        """No samples at any pixel."""
        _, h, w = self.size
        counts = torch.zeros(1, 1, h, w, dtype=torch.int64, device=self.device)
        return Samples(_lazy_zeros((1, self.max_samples, 3, h, w), self.device), counts)

    def read(self, before: Samples, counts: Int[Tensor, "1 1 h w"]) -> Float[Tensor, "1 s 3 h w"]:
        """Radiance of the first `counts` samples of each pixel; traces those not in `before`."""
        pixels, slots = missing_samples(before.counts.flatten(), counts.flatten())
        values = self._trace(pixels, slots) * self.exposure
        radiance = self.empty().radiance
        filled = int(before.counts.max())  # slots beyond are empty at every pixel
        radiance[:, :filled] = before.radiance[:, :filled]
        row, column = pixels // self.size.w, pixels % self.size.w
        radiance[0].permute(0, 2, 3, 1)[slots, row, column] = values
        return radiance

    def _trace(self, pixels: Int[Tensor, " n"], slots: Int[Tensor, " n"]) -> Float[Tensor, "n 3"]:
        """Radiance of these samples as the stored pool's file would hold it, in float32."""
        if self.tracer.time != self.time:
            self.tracer.set_time(self.time)
        numbers = torch.tensor(self.sample_order, device=slots.device)[slots]
        launches = zip(*(torch.split(each, MAX_PATHS) for each in (pixels, numbers)), strict=True)
        radiance = torch.cat([self.tracer.trace_tensors(*pairs) for pairs in launches])
        # another machine may trace a firefly that the file's dtype cannot hold
        return radiance.clamp_max(torch.finfo(self.stored_dtype).max).to(self.stored_dtype).float()


@dataclass(frozen=True)
class LiveClip(ClipWrapper):
    """A rendered clip with stored G-buffers and references, and with live pools."""

    clip: StoredClip
    tracer: Tracer
    max_samples: int | None = None  # per pixel that can be drawn; None: as of `clip`

    def __iter__(self) -> Iterator[Frame]:
        """The frames in order; the scene moves to each as it is reached."""
        return (self.frame(index) for index in range(len(self)))

    def frame(self, index: int) -> Frame:
        """Frame `index`, float32 on the clip's device."""
        clip, header = self.clip, self.clip.header
        order, seed = sample_order(clip.seed, clip.name, index, header.pool_spp)
        most = self.max_samples or clip.max_samples
        numbers = (*order, *range(header.pool_spp, most))[:most]  # the stored ones come first
        file = exr_path(clip.arrays.folder, f"pool.{clip.pool}", index)
        self.tracer.set_time(float(index))  # as a renderer does before it traces
        pool = LivePool(
            self.tracer,
            float(index),
            numbers,
            seed,
            header.exposure,
            torch.from_numpy(np.empty(0, channel_dtype(file, "s0.R"))).dtype,
            clip.device,
        )
        return clip.frame_with_pool(index, pool)


def scene_of_folder(folder: Path) -> Scene:
    """The scene that a clip folder was rendered from, built again.

    Raises ClipError if `rlbench render` did not write the folder, or if the scene has changed
    since, and LookupError if the scene is not installed.
    """
    header = read_header(folder)
    error = f"clip {folder} cannot be sampled live"
    if not (key := read_content_key(folder)):
        raise ClipError(f"{error}: `rlbench render` did not write it. Use --pool stored")
    scene = scene_of_header(header)
    frames = read_whole_length(folder) or header.frames
    current, rendered = fingerprint(scene, frames), key.split()[0]
    if current != rendered:
        raise ClipError(
            f"{error}: its scene '{header.name}' has changed since (fingerprint {current}, the "
            f"clip has {rendered}). Render the clip again, or use --pool stored"
        )
    return scene


def open_live_clip(stored: StoredClip, max_samples: int | None = None) -> LiveClip:
    """The clip with live pools of `max_samples` per pixel; None: as many as the stored ones.

    Raises ClipError as `scene_of` does, and for a pool other than `path`.
    """
    if stored.pool not in FRAME_POOLS:
        raise ClipError(
            f"pool '{stored.pool}' cannot be sampled live, because its samples depend on those of "
            f"earlier frames and neighbouring pixels. Use --pool stored. Live pools: "
            f"{', '.join(FRAME_POOLS)}"
        )
    return LiveClip(stored, _cached_tracer(stored.arrays.folder, stored.digest), max_samples)


def open_wavefronts(folder: Path) -> Tracer:
    """The tracer of a clip's scene, where it traces any pixels at their own cost.

    Raises ClipError as `scene_of_folder` does, and for the scalar variant: it traces whole images.
    """
    scene_of_folder(folder)  # raises at once, while finding out the variant may take seconds
    if select_variant().startswith("scalar"):
        raise ClipError(
            f"clip {folder} cannot be traced in part: without LLVM or CUDA, whole images are "
            "traced. Run rlbench doctor"
        )
    return open_clip_tracer(folder)


def open_clip_tracer(folder: Path) -> Tracer:
    """The tracer of a clip's scene, at its size and with its radiance cap."""
    header = read_header(folder)
    cap = header.radiance_cap / header.exposure
    size = header.height, header.width
    frames = read_whole_length(folder) or header.frames
    scene = scene_of_folder(folder).inspect(frames, size)
    return open_tracer(scene, *size, header.seed, cap)


@lru_cache(maxsize=1)
def _cached_tracer(folder: Path, digest: str) -> Tracer:
    """The tracer of a clip, shared by all methods that run on it; one clip is open at a time."""
    return open_clip_tracer(folder)


def _lazy_zeros(shape: tuple[int, ...], device: torch.device) -> Tensor:
    """Zeros, whose memory is allocated on first write on a CPU, as numpy does, not torch."""
    if device.type == "cpu":
        return torch.from_numpy(np.zeros(shape, np.float32))
    return torch.zeros(shape, device=device)


def missing_samples(
    before: Int[Tensor, " p"], counts: Int[Tensor, " p"]
) -> tuple[Int[Tensor, " n"], Int[Tensor, " n"]]:
    """Pixel and slot of each sample from number `before` up to `counts`, pixel by pixel.

    >>> pixels, slots = missing_samples(torch.tensor([1, 0, 2]), torch.tensor([3, 1, 2]))
    >>> pixels.tolist(), slots.tolist()
    ([0, 0, 1], [1, 2, 0])
    """
    new = (counts - before).clamp_min(0)
    pixels = torch.arange(len(new), device=new.device).repeat_interleave(new)
    first = new.cumsum(0) - new  # index of each pixel's first sample in the result
    slots = torch.arange(len(pixels), device=new.device) - (first - before)[pixels]
    return pixels, slots


def scatter_factor(tracer: Tracer, counts: Int[Tensor, "1 1 h w"]) -> float:
    """Time of a sample at these counts divided by that of a sample of a full frame at 1 spp.

    Both are traced in turn, so that other load on the machine slows both alike. Uniform counts have
    about 1; scattered ones have more, because neighbouring paths are less alike, and very few have
    much more, because a launch has a fixed cost. Raises ValueError without a sample.
    """
    drawn = counts.flatten()
    if not drawn.sum():
        raise ValueError("the counts are all zero; at least one sample is needed")
    pixels, samples = missing_samples(torch.zeros_like(drawn), drawn)
    relative = tracer.relative_cost(lambda: tracer.trace_tensors(pixels, samples, "pilot"), 1)
    return relative * len(drawn) / float(drawn.sum())
