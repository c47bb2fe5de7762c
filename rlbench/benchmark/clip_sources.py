"""Where a clip of the benchmark comes from: what it holds, and how it is opened for one method."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cache, cached_property
from hashlib import sha256
from itertools import islice
from pathlib import Path
from typing import Protocol

import torch

from rlbench.clips.stored import Header, open_clip, read_header
from rlbench.family import Traits
from rlbench.frames import Clip, Frame, Size
from rlbench.render.jobs.live_pool import open_live, scene_of
from rlbench.render.mitsuba.llvm import select_variant
from rlbench.system import code_hash, provenance

POOLS = ("stored", "live")  # samples read from the clip's files, or traced when they are bought


class Source(Protocol):
    """A clip that can be opened once for each cell, with what the cell's method declared."""

    @property
    def header(self) -> Header:
        """What the clip says of itself."""

    def content(self, pool: str) -> str:
        """Hash of its content, with the samples of one pool, or none where it lacks that pool."""

    @property
    def cost_key(self) -> str:
        """What the time of buying a sample depends on, empty if on nothing of the clip."""

    def open(self, traits: Traits, spp: float, seed: int, device: torch.device) -> Clip:
        """The clip, of which nothing is read that the method cannot use at this budget."""


@dataclass(frozen=True)
class StoredSource:
    """A clip folder, format v1."""

    folder: Path
    _known: dict[str, str] = field(default_factory=dict, compare=False, repr=False)  # by pool

    @cached_property
    def header(self) -> Header:
        """What clip.toml says."""
        return read_header(self.folder)

    def content(self, pool: str) -> str:
        """Hash of the folder's content with the samples of `pool`."""
        if pool not in self._known:  # every cell asks, and each answer looks at every file
            there = pool if pool in self.header.pools else self.header.pools[0]
            found = open_clip(self.folder, inputs=frozenset(), max_samples=1, pool=there).digest
            self._known[pool] = found if there == pool else f"{found} without {pool}"
        return self._known[pool]

    @property
    def cost_key(self) -> str:
        """Nothing: stored samples are handed out alike."""
        return ""

    def open(self, traits: Traits, spp: float, seed: int, device: torch.device) -> Clip:
        """The clip with the buffers and the samples that `traits` can touch at `spp`."""
        slots = max_samples_needed(traits, spp, self.header.pool_spp)
        return open_clip(self.folder, traits.inputs, slots, traits.pool, seed, device)


@dataclass(frozen=True)
class LiveSource(StoredSource):
    """A clip folder whose samples are traced when they are bought."""

    def content(self, pool: str) -> str:
        """Hash of the folder's content and of what traces: two machines' samples may differ."""
        tracer = f"{_tracer()} {select_variant()} {provenance.machine().name}"
        content = f"{super().content(pool)} live {tracer} {provenance.versions()['mitsuba']}"
        return sha256(content.encode()).hexdigest()[:32]

    @property
    def cost_key(self) -> str:
        """The clip's name: each scene takes its own time to trace."""
        return self.header.name

    def open(self, traits: Traits, spp: float, seed: int, device: torch.device) -> Clip:
        """The clip with the buffers that `traits` reads; no stored sample is read."""
        slots = max_samples_needed(traits, spp, self.header.pool_spp)
        return open_live(open_clip(self.folder, traits.inputs, slots, traits.pool, seed, device))


@dataclass(frozen=True)
class FirstFrames:
    """The first frames of a clip, as a clip."""

    clip: Clip
    frames: int

    @property
    def name(self) -> str:
        """The whole clip's name."""
        return self.clip.name

    @property
    def scene(self) -> str:
        """The scene that it shows."""
        return self.clip.scene

    @property
    def size(self) -> Size:
        """Clips in the batch and pixels of each."""
        return self.clip.size

    @property
    def digest(self) -> str:
        """The whole clip's digest."""
        return self.clip.digest

    def __len__(self) -> int:
        """Number of frames."""
        return min(self.frames, len(self.clip))

    def __iter__(self) -> Iterator[Frame]:
        """The first frames in order."""
        return islice(iter(self.clip), self.frames)


@cache
def _tracer() -> str:
    """Hash of the code that traces live samples."""
    return code_hash.code_hash(["rlbench.render", "rlbench.scenes"], core=())


def open_source(folder: Path, pool: str) -> StoredSource:
    """A clip folder with the pool of that name, one of POOLS.

    Raises ClipError where a live pool is asked for and the clip's scene cannot be traced.
    """
    if pool != "live":
        return StoredSource(folder)
    scene_of(folder)
    return LiveSource(folder)


def max_samples_needed(traits: Traits, spp: float, stored: int) -> int:
    """Most samples of one pixel: up to the cap for a method that adapts, else ceil(spp)."""
    most = stored if traits.max_samples is None else min(stored, traits.max_samples)
    return most if traits.adaptive else min(most, max(1, traits.min_samples, math.ceil(spp)))
