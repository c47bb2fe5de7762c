"""Procedural clips on disk, in the format that a renderer writes: for training, tests, trials."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from rlbench.clips.frame_files import write_frame
from rlbench.clips.header import Header, write_header
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.frames import Size, StoredPool

QUICK_PREFIX = "procedural-"  # of the names of clips for a quick training
QUICK_REMARK = "quick: trained on procedural clips, to try the training, not for results"


def write_procedural_clip(
    folder: Path, seed: int = 0, side: int = 128, frames: int = 6, **header: Any
) -> Path:
    """Write a clip of a moving world with `side` x `side` pixels; returns its folder.

    The clip is called as the folder is. `header` overrides fields of clip.toml. The header is
    written last, so a folder that has one is complete.
    """
    clip = procedural_clip(seed, Size(1, side, side), frames)
    for frame in clip.frames:
        gbuffer = {name: _to_array(tensor) for name, tensor in frame.gbuffer.buffers.items()}
        assert isinstance(frame.pool, StoredPool)
        pool = np.stack([_to_array(sample) for sample in frame.pool.radiance.unbind(1)])
        halves = (_to_array(frame.reference.half_a), _to_array(frame.reference.half_b))
        write_frame(folder, frame.index, gbuffer, {"path": pool}, *halves)
    fields: dict[str, Any] = {
        "name": folder.name,
        "scene": folder.name,
        "sampler": "procedural",
        "height": side,
        "width": side,
        "frames": frames,
        "reference_spp": (64,) * frames,  # the reference is exact, and a number is required
    }
    write_header(folder, Header(**fields | header))
    return folder


def _to_array(tensor: Tensor) -> NDArray[np.float32]:
    """The only image of a batch, [h w c]."""
    array: NDArray[np.float32] = tensor[0].permute(1, 2, 0).numpy()
    return array
