"""Sources of clips: a header, a content hash, and how the clip is opened for one method."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import torch

from rlbench.clips.digest import clip_digest
from rlbench.clips.header import Header, read_header
from rlbench.clips.stored import StoredClip, open_clip
from rlbench.family import Traits
from rlbench.frames import Clip
from rlbench.registry import apps
from rlbench.registry.discovery import resolve

STORED = "stored"  # the pool of samples in the clip's files; apps add others


@dataclass(frozen=True)
class StoredSource:
    """A clip folder, format v1, that each cell opens with the traits of its method."""

    folder: Path
    limit_frames: int | None = None  # the clip ends after so many frames
    _digests: dict[tuple[str, int], str] = field(
        default_factory=dict, compare=False, repr=False
    )  # by pool and number of frames

    def first(self, frames: int | None) -> StoredSource:
        """The clip that ends after `frames` frames; itself where it has no more."""
        is_whole = frames is None or frames >= self.header.frames
        return self if is_whole else replace(self, limit_frames=frames)

    @cached_property
    def header(self) -> Header:
        """The content of clip.toml, of the clip's first frames where they are limited."""
        return read_header(self.folder).first(self.limit_frames)

    def content(self, pool: str) -> str:
        """Hash of the clip with the samples of a pool; without samples if it has no such pool."""
        key = pool, self.header.frames
        if key not in self._digests:  # a digest reads every file, and every cell needs one
            opened = pool if pool in self.header.pools else self.header.pools[0]
            missing = "" if opened == pool else f" without {pool}"
            self._digests[key] = f"{clip_digest(self.folder, self.header, opened)}{missing}"
        return self._digests[key]

    @property
    def cost_key(self) -> str:
        """What the time to fetch a sample depends on; stored ones take as long for every clip."""
        return ""

    def pool_spp(self, spp: float) -> int:
        """Samples that one pixel can have at this budget; here those stored, at any."""
        return self.header.pool_spp

    def open(self, traits: Traits, spp: float, seed: int, device: torch.device) -> Clip:
        """The clip with the buffers and samples that `traits` can use at `spp`."""
        return self._open(
            traits, max_samples_needed(traits, spp, self.header.pool_spp), seed, device
        )

    def _open(
        self, traits: Traits, max_samples: int, seed: int, device: torch.device
    ) -> StoredClip:
        chosen = traits.inputs, max_samples, traits.pool, seed, device
        return open_clip(self.folder, *chosen, self.limit_frames)


def list_pools() -> list[str]:
    """What `--pool` may name: the stored samples, and what apps trace when it is drawn."""
    return [STORED, *apps.merge_parts("pools")]


def open_source(folder: Path, pool: str) -> StoredSource:
    """The source of a clip folder with `pool` samples, one of `list_pools`.

    Raises ClipError for a live pool if the clip's scene cannot be traced.
    """
    if pool == STORED:
        return StoredSource(folder)
    source: StoredSource = resolve(apps.merge_parts("pools")[pool])(folder)
    return source


def samples_at_cap(traits: Traits, pool_spp: int) -> int:
    """Most samples that one pixel can have, from a pool of `pool_spp`."""
    return pool_spp if traits.max_samples is None else min(pool_spp, traits.max_samples)


def max_samples_needed(traits: Traits, spp: float, pool_spp: int) -> int:
    """Most samples of one pixel that a method can draw from a pool of `pool_spp`.

    Adaptive methods may draw up to their `max_samples` in one pixel, others ceil(spp).
    """
    limit = samples_at_cap(traits, pool_spp)
    if traits.adaptive:
        return limit
    return min(limit, max(1, traits.min_samples, math.ceil(spp)))
