"""The source of a clip whose samples are traced when they are drawn: --pool live."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from hashlib import sha256
from pathlib import Path

import torch

from rlbench.apps.render.jobs.live_pool import open_live_clip, scene_of_folder
from rlbench.apps.render.mitsuba.variant import select_variant
from rlbench.benchmark.clip_sources import StoredSource, max_samples_needed
from rlbench.family import Traits
from rlbench.frames import Clip
from rlbench.system import code_hash, provenance


@dataclass(frozen=True)
class LiveSource(StoredSource):
    """A clip folder whose samples are traced when they are drawn."""

    def content(self, pool: str) -> str:
        """Hash of the folder, tracer and machine: samples of two machines may differ."""
        tracer = f"{_tracer()} {select_variant()} {provenance.machine().name}"
        content = f"{super().content(pool)} live {tracer} {provenance.versions()['mitsuba']}"
        return sha256(content.encode()).hexdigest()[:32]

    @property
    def cost_key(self) -> str:
        """The clip's name: the time to trace a sample differs between scenes."""
        return self.header.name

    def pool_spp(self, spp: float) -> int:
        """As many as are stored, so that images equal those of stored samples; above, twice the
        budget, so that densities can still vary.
        """
        stored = self.header.pool_spp
        return stored if spp <= stored else 2 * math.ceil(spp)

    def open(self, traits: Traits, spp: float, seed: int, device: torch.device) -> Clip:
        """The clip with the buffers that `traits` declare; no stored sample is read."""
        max_samples = max_samples_needed(traits, spp, self.pool_spp(spp))
        return open_live_clip(self._open(traits, max_samples, seed, device), max_samples)


@cache
def _tracer() -> str:
    """Hash of the code that traces live samples."""
    return code_hash.code_hash(["rlbench.apps.render"], core=())


def open_live_source(folder: Path) -> LiveSource:
    """The source of a clip folder. Raises ClipError if the clip's scene cannot be traced."""
    scene_of_folder(folder)
    return LiveSource(folder)
