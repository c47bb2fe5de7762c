"""What a page or a video shows of clips: reference, G-buffer, and the kept images of methods."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from rlbench.benchmark.cell_images import KeptCell, KeptImages, find_kept_cells
from rlbench.benchmark.cell_key import CellKey
from rlbench.benchmark.clip_sources import StoredSource
from rlbench.clips.stored import open_clip
from rlbench.frames import BUFFERS

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class ShownImages:
    """The output of one method on all frames of a clip."""

    method: str  # name of the rows
    target_spp: float
    seed: int  # of the sample order
    device: str  # model name
    frames: Float[Array, "t 3 h w"]  # linear radiance
    counts: Float[Array, "t h w"]  # samples of each pixel; t is 0 where they are not known
    psnr: tuple[float, ...] = ()  # dB of each frame, NaN where the results have none; or not read


@dataclass(frozen=True)
class ShownClip:
    """A clip and the images of all methods on it."""

    name: str
    scene: str
    fps: float
    cuts: tuple[int, ...]  # first frames of shots, without frame 0
    light_changes: tuple[int, ...]  # first frames under another light
    reference: Float[Array, "t 3 h w"]  # linear radiance, exposed; t is 0 for loose images
    buffers: dict[str, Any]  # albedo, normal, depth, motion: float [t c h w]; some may be absent
    images: tuple[ShownImages, ...]


@dataclass(frozen=True)
class ShownClips:
    """Clips with their images; each is read when it is its turn, so that one at a time is held."""

    kept: tuple[tuple[StoredSource, tuple[KeptImages, ...]], ...] = ()
    buffers: frozenset[str] = frozenset(BUFFERS)  # channels of the G-buffer to read

    def __len__(self) -> int:
        """Number of clips."""
        return len(self.kept)

    def __iter__(self) -> Iterator[ShownClip]:
        """Read the clips in their order."""
        return (_read_clip(source, images, self.buffers) for source, images in self.kept)


def find_shown_clips(
    folder: Path,
    clips: Sequence[StoredSource],
    methods: Collection[str],
    budgets: Collection[float],
    buffers: Collection[str] = BUFFERS,
) -> ShownClips:
    """Each of `clips` with the images that a results folder keeps of these methods and budgets.

    Clips without images are left out, and G-buffer channels that are not among `buffers`. Of
    several seeds or devices the first is shown. Raises KeptImagesError where there are no images,
    or where a clip has changed since.
    """
    first: dict[CellKey, KeptCell] = {}  # without seed and device
    for kept in sorted(
        find_kept_cells(folder, clips, methods), key=lambda kept: kept.cell.key.seed
    ):
        if kept.cell.key.target_spp in budgets:
            first.setdefault(replace(kept.cell.key, seed=0, device=""), kept)
    images = [
        tuple(kept.images for kept in first.values() if kept.clip.folder == clip.folder)
        for clip in clips
    ]
    kept_by_clip = tuple((clip, own) for clip, own in zip(clips, images, strict=True) if own)
    return ShownClips(kept_by_clip, frozenset(buffers))


def _read_clip(
    source: StoredSource, kept: Sequence[KeptImages], buffers: Collection[str]
) -> ShownClip:
    header = source.header
    length = max(map(len, kept))
    inputs = frozenset(buffers) & set(header.buffers)
    clip = open_clip(source.folder, inputs, max_samples=1, pool=header.pools[0])
    frames = [clip.frame(index) for index in range(length)]
    names = [name for name in BUFFERS if name in frames[0].gbuffer.buffers]
    return ShownClip(
        name=header.name,
        scene=header.scene,
        fps=header.fps,
        cuts=tuple(frame for frame in header.cuts if frame < length),
        light_changes=tuple(frame for frame in header.light_changes if frame < length),
        reference=np.stack([frame.reference.mean[0].numpy() for frame in frames]),
        buffers={
            name: np.stack([frame.gbuffer.buffers[name][0].numpy() for frame in frames])
            for name in names
        },
        images=tuple(map(_read_images, kept)),
    )


def _read_images(kept: KeptImages) -> ShownImages:
    frames = [kept.frame(index) for index in range(len(kept))]
    key = kept.cell.key
    return ShownImages(
        key.method,
        key.target_spp,
        key.seed,
        key.device,
        np.stack([frame.image for frame in frames]),
        np.stack([frame.counts for frame in frames]),
    )


def at_budget(
    clip: ShownClip, methods: Sequence[str], target_spp: float, scores: pd.DataFrame
) -> ShownClip:
    """The clip with the images of `methods` alone, in their order, at one budget, with their PSNR.

    `scores` are rows of the results. All methods must be among the images of `clip`.
    """
    by_key = {(each.method, each.target_spp): each for each in clip.images}
    images = (by_key[method, target_spp] for method in methods)
    return replace(clip, images=tuple(_with_psnr(each, clip.name, scores) for each in images))


def _with_psnr(images: ShownImages, clip: str, scores: pd.DataFrame) -> ShownImages:
    is_own = (scores["method"] == images.method) & (scores["clip"] == clip)
    is_own &= (scores["target_spp"] == images.target_spp) & (scores["seed"] == images.seed)
    is_own &= (scores["device"] == images.device) & (scores["metric"] == "psnr")
    by_frame = scores[is_own].set_index("frame")["value"].to_dict()
    psnr = tuple(by_frame.get(frame, math.nan) for frame in range(len(images.frames)))
    return replace(images, psnr=psnr)
