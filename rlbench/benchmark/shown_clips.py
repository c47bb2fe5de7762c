"""What a page shows of each clip: reference, G-buffer, and the kept images of all methods."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Float16
from numpy import ndarray as Array

from rlbench.benchmark import cell_images, results
from rlbench.benchmark.cell_images import KeptImages
from rlbench.benchmark.clip_sources import StoredSource
from rlbench.clips.stored import open_clip
from rlbench.errors import RlbenchError
from rlbench.frames import BUFFERS

__all__ = ["ShownClip", "ShownClipError", "ShownImages", "kept_presets", "read_shown_clips"]


class ShownClipError(RlbenchError, ValueError):
    """Kept images that show another version of a clip."""


@dataclass(frozen=True)
class ShownImages:
    """The output of one method on all frames of a clip."""

    method: str  # name of the rows
    target_spp: float
    frames: Float16[Array, "t 3 h w"]  # linear radiance
    counts: Float16[Array, "t h w"]  # samples of each pixel


@dataclass(frozen=True)
class ShownClip:
    """A clip and the images of all methods on it."""

    name: str
    scene: str
    fps: float
    cuts: tuple[int, ...]  # first frames of shots, without frame 0
    reference: Float[Array, "t 3 h w"]  # linear radiance, exposed
    buffers: dict[str, Any]  # albedo, normal, depth, motion: float [t c h w]; some may be absent
    images: tuple[ShownImages, ...]


def kept_presets(folder: Path) -> set[str]:
    """Presets of the clips that the kept images show; "" stands for clips without one."""
    return {images.cell.key.preset for images in cell_images.list_images(folder)}


def read_shown_clips(
    folder: Path,
    clips: Sequence[StoredSource],
    methods: Collection[str] = (),
    target_spp: Collection[float] = (),
) -> list[ShownClip]:
    """Each of `clips` with the images that a results folder keeps of it; others are left out.

    Empty `methods` and `target_spp` select all. Of several seeds or devices the first is shown.
    Raises ShownClipError for images of a clip that has changed since.
    """
    current = results.cells(folder)
    kept: dict[tuple[str, str, float], KeptImages] = {}
    for cell in sorted(current, key=lambda cell: (cell.key.seed, cell.file_stem)):
        key = (cell.key.clip, cell.key.method, cell.key.target_spp)
        is_selected = (not methods or key[1] in methods) and (
            not target_spp or key[2] in target_spp
        )
        if is_selected and key not in kept and (images := cell_images.find_images(folder, cell)):
            kept[key] = images
    read = []
    for clip in clips:
        if own := [images for key, images in kept.items() if key[0] == clip.header.name]:
            read.append(_read_clip(clip, own))
    return read


def _read_clip(source: StoredSource, kept: Sequence[KeptImages]) -> ShownClip:
    for images in kept:
        if (digest := source.content(images.pool)) != images.clip_digest:
            raise ShownClipError(
                f"the images of '{images.cell.key}' show a clip with digest {images.clip_digest}, "
                f"but {source.folder} has {digest}. Name the clip of the images with --clips, or "
                "repeat `rlbench run --keep-images`"
            )
    header = source.header
    length = max(map(len, kept))
    inputs = frozenset(BUFFERS) & set(header.buffers)
    clip = open_clip(source.folder, inputs, max_samples=1, pool=header.pools[0])
    frames = [clip.frame(index) for index in range(length)]
    names = [name for name in BUFFERS if name in frames[0].gbuffer.buffers]
    return ShownClip(
        name=header.name,
        scene=header.scene,
        fps=header.fps,
        cuts=tuple(cut for cut in header.cuts if cut < length),
        reference=np.stack([frame.reference.mean[0].numpy() for frame in frames]),
        buffers={
            name: np.stack([frame.gbuffer.buffers[name][0].numpy() for frame in frames])
            for name in names
        },
        images=tuple(map(_read_images, kept)),
    )


def _read_images(kept: KeptImages) -> ShownImages:
    frames = [kept.frame(index) for index in range(len(kept))]
    return ShownImages(
        kept.cell.key.method,
        kept.cell.key.target_spp,
        np.stack([frame.image for frame in frames]),
        np.stack([frame.counts for frame in frames]),
    )
