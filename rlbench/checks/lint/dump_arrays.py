"""The first frames of a dump as the arrays of a clip, without writing one."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from rlbench.checks.lint.clip_arrays import ClipArrays
from rlbench.checks.lint.declared import without_stand_ins
from rlbench.clips.importers import writer
from rlbench.clips.importers.dump import find_dump_sequences
from rlbench.clips.importers.layout import Layout
from rlbench.clips.importers.sequence import Pixels, SourceError

__all__ = ["import_arrays"]

MAX_FRAMES = 4
MAX_SAMPLES = 2  # enough for what is read from them


def import_arrays(source: Path, layout: Layout) -> ClipArrays:
    """Up to 4 frames of the first clip of a dump, with the buffers that it has.

    Raises SourceError where the layout does not fit, or no file of radiance matches.
    """
    sequences = find_dump_sequences(source, layout)
    if not sequences:
        raise SourceError(f"{source}: no file matches {' or '.join(layout.radiance.patterns)}")
    sequence = sequences[0]
    count = min(MAX_SAMPLES, *sequence.counts)
    frames = [sequence.read(number, count) for number in sequence.numbers[:MAX_FRAMES]]
    gbuffer = {name: _stack([frame.gbuffer[name] for frame in frames]) for name in sequence.buffers}
    header = writer.clip_header(sequence, min(sequence.counts))
    pools = {"path": _stack([frame.pool for frame in frames])}
    halves = (_stack([f.half_a for f in frames]), _stack([f.half_b for f in frames]))
    return without_stand_ins(ClipArrays(header, gbuffer, pools, *halves)).sanitized


def _stack(images: Sequence[Pixels]) -> Tensor:
    return torch.from_numpy(np.stack(images).astype(np.float32)).movedim(-1, -3)
