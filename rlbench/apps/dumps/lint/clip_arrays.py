"""The arrays of a clip folder, as stored, and of the first frames of a dump, as imported.

Nothing is validated, scaled by exposure or corrected.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from rlbench import registry
from rlbench.apps.dumps.importers import writer
from rlbench.apps.dumps.importers.dump import find_dump_sequences
from rlbench.apps.dumps.importers.layout import Layout
from rlbench.checks.result import CheckResult, warning
from rlbench.clips.exr import read_exr
from rlbench.clips.frame_files import channel_names, exr_path, image_names
from rlbench.clips.header import Header, read_header
from rlbench.clips.image_files import Pixels
from rlbench.errors import SourceError


@dataclass(frozen=True)
class ClipArrays:
    """The first t frames of a clip, float32, radiance as traced. Values may be NaN or infinite."""

    header: Header
    gbuffer: Mapping[str, Float[Tensor, "t c h w"]]  # by buffer name
    pools: Mapping[str, Float[Tensor, "t s 3 h w"]]  # by kind of pool
    half_a: Float[Tensor, "t 3 h w"]
    half_b: Float[Tensor, "t 3 h w"]

    def __len__(self) -> int:
        """Number of frames read; the clip may have more."""
        return len(self.half_a)

    @cached_property
    def sanitized(self) -> ClipArrays:
        """A copy with 0 for NaN and infinity, so that one bad pixel does not fail every check.

        Depth keeps +inf, which is background.
        """
        gbuffer = {
            name: _replace_nonfinite(buffer, torch.inf if name.startswith("depth") else 0.0)
            for name, buffer in self.gbuffer.items()
        }
        pools = {kind: _replace_nonfinite(pool) for kind, pool in self.pools.items()}
        halves = (_replace_nonfinite(half) for half in (self.half_a, self.half_b))
        return ClipArrays(self.header, gbuffer, pools, *halves)

    @property
    def without_stand_ins(self) -> ClipArrays:
        """The arrays without buffers that are constants because the source had none."""
        absent = {name for name in self.gbuffer if f"no {name}" in self.header.limitations}
        gbuffer = {name: image for name, image in self.gbuffer.items() if name not in absent}
        return replace(self, gbuffer=gbuffer)

    @property
    def reference(self) -> Float[Tensor, "t 3 h w"]:
        """The mean of both halves."""
        return (self.half_a + self.half_b) / 2

    @property
    def surface_mask(self) -> Float[Tensor, "t 1 h w"]:
        """Where depth shows a surface, bool."""
        depth = self.gbuffer["depth"]
        return depth.isfinite() & (depth != 0)


def absent(buffer: str) -> CheckResult:
    """The result of the check of a buffer that a clip does not have."""
    found = f"the clip has no {buffer} buffer"
    return warning(buffer, found, "write one if a method needs it as input")


def read_clip_arrays(folder: Path, frames: int = 8) -> ClipArrays:
    """The first `frames` frames of a finished clip (0: all), without the checks of `open_clip`.

    Pools of correlated samples, such as ReSTIR's, are left out, because the checks of samples
    assume independence.

    Raises ClipError where the folder is not a finished clip, or lacks a file or a channel.
    """
    header = read_header(folder)
    indices = range(min(frames or header.frames, header.frames))

    def read(kind: str, names: list[str]) -> Tensor:
        planes = [
            read_exr(exr_path(folder, kind, i), channel_names(names), header.height, header.width)
            for i in indices
        ]
        return torch.from_numpy(np.stack([p.astype(np.float32) for p in planes]))

    gbuffer = {name: read("view", [name]) for name in header.buffers}
    pools = {}
    for kind in filter(_is_independent, header.pools):
        planes = read(f"pool.{kind}", image_names(header, f"pool.{kind}"))
        pools[kind] = planes.view(len(planes), -1, 3, header.height, header.width)
    halves = (read("referenceA", ["rgb"]), read("referenceB", ["rgb"]))
    return ClipArrays(header, gbuffer, pools, *_stand_in(halves, pools))


def _stand_in(halves: Sequence[Tensor], pools: Mapping[str, Tensor]) -> list[Tensor]:
    """Halves of the reference, and where a frame has none the mean of its samples."""
    absent = halves[0].flatten(1).isnan().all(1)[:, None, None, None]
    means = [pool.mean(1) for pool in pools.values()]
    return [half.where(~absent, means[0]) if means else half for half in halves]


def _is_independent(pool: str) -> bool:
    is_installed = pool in registry.list_plugins("pools")
    return not is_installed or bool(registry.load_plugin("pools", pool).independent)


def _replace_nonfinite(image: Tensor, positive_infinity: float = 0.0) -> Tensor:
    return image.nan_to_num(nan=0.0, posinf=positive_infinity, neginf=0.0)


MAX_FRAMES = 4
MAX_SAMPLES = 2  # enough for what is read from them


def import_arrays(source: Path, layout: Layout, start: int = 0) -> ClipArrays:
    """Up to 4 frames of the first clip of a dump from `start` on, with the buffers that it has.

    Raises SourceError where the layout does not fit, or no file of radiance matches.
    """
    sequences = find_dump_sequences(source, layout)
    if not sequences:
        raise SourceError(f"{source}: no file matches {' or '.join(layout.radiance.patterns)}")
    sequence = sequences[0]
    count = min(MAX_SAMPLES, *sequence.counts)
    frames = [
        sequence.read(number, count) for number in sequence.numbers[start : start + MAX_FRAMES]
    ]
    gbuffer = {name: _stack([frame.gbuffer[name] for frame in frames]) for name in sequence.buffers}
    header = writer.clip_header(sequence, min(sequence.counts))
    pools = {"path": _stack([frame.pool for frame in frames])}
    halves = _stand_in(
        [_stack([f.half_a for f in frames]), _stack([f.half_b for f in frames])], pools
    )
    return ClipArrays(header, gbuffer, pools, *halves).without_stand_ins.sanitized


def _stack(images: Sequence[Pixels]) -> Tensor:
    return torch.from_numpy(np.stack(images).astype(np.float32)).movedim(-1, -3)
