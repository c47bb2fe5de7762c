"""All that a clip folder holds, as it lies there: nothing is refused, exposed or repaired."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from rlbench import registry
from rlbench.clips.exr import read_exr
from rlbench.clips.frame_files import channels, exr_path, images
from rlbench.clips.header import Header, read_header


@dataclass(frozen=True)
class ClipArrays:
    """The first t frames of a clip, float32, radiance as traced. Values may be NaN or infinite."""

    header: Header
    gbuffer: Mapping[str, Float[Tensor, "t c h w"]]  # by buffer name
    pools: Mapping[str, Float[Tensor, "t s 3 h w"]]  # by kind
    half_a: Float[Tensor, "t 3 h w"]
    half_b: Float[Tensor, "t 3 h w"]

    def __len__(self) -> int:
        """Number of frames that are here; the clip may have more."""
        return len(self.half_a)

    @cached_property
    def sound(self) -> ClipArrays:
        """The same with 0 for what is not finite, so that one bad pixel does not spoil all checks.

        Depth keeps +inf, which is background.
        """
        gbuffer = {
            name: _sound(v, torch.inf if name.startswith("depth") else 0.0)
            for name, v in self.gbuffer.items()
        }
        pools = {kind: _sound(p) for kind, p in self.pools.items()}
        return ClipArrays(self.header, gbuffer, pools, _sound(self.half_a), _sound(self.half_b))

    @property
    def reference(self) -> Float[Tensor, "t 3 h w"]:
        """The mean of both halves."""
        return (self.half_a + self.half_b) / 2

    @property
    def solid(self) -> Float[Tensor, "t 1 h w"]:
        """Where depth says that there is a surface, bool."""
        depth = self.gbuffer["depth"]
        return depth.isfinite() & (depth != 0)


def read_footage(folder: Path, frames: int = 8) -> ClipArrays:
    """The first `frames` frames of a finished clip (0: all), read past the checks of `open_clip`.

    Pools whose samples hang together, as those of ReSTIR do, are left out: what is proved here of
    samples is not true of them.

    Raises ClipError where the folder is not a finished clip, or lacks a file or a channel.
    """
    header = read_header(folder)
    kept = range(min(frames or header.frames, header.frames))

    def read(kind: str, names: list[str]) -> Tensor:
        planes = [
            read_exr(exr_path(folder, kind, i), channels(names), header.height, header.width)
            for i in kept
        ]
        return torch.from_numpy(np.stack([p.astype(np.float32) for p in planes]))

    gbuffer = {name: read("view", [name]) for name in header.buffers}
    pools = {}
    for kind in filter(_independent, header.pools):
        planes = read(f"pool.{kind}", images(header, f"pool.{kind}"))
        pools[kind] = planes.view(len(planes), -1, 3, header.height, header.width)
    return ClipArrays(
        header, gbuffer, pools, read("referenceA", ["rgb"]), read("referenceB", ["rgb"])
    )


def _independent(pool: str) -> bool:
    known = pool in registry.names("pools")
    return not known or bool(registry.load("pools", pool).independent)


def _sound(image: Tensor, positive: float = 0.0) -> Tensor:
    return image.nan_to_num(nan=0.0, posinf=positive, neginf=0.0)
