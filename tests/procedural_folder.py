"""Clip folders of the procedural world, in the format that a renderer writes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from rlbench.clips.procedural.clip import procedural_clip
from rlbench.clips.stored import Header, write_frame, write_header
from rlbench.frames import Size


def write_world(folder: Path, seed: int = 0, side: int = 48, frames: int = 3) -> Path:
    """Write a complete clip of a moving world with `side` x `side` pixels."""
    for frame in procedural_clip(seed, Size(1, side, side), frames):
        gbuffer = {name: _image(tensor) for name, tensor in frame.gbuffer.buffers.items()}
        pool = np.stack([_image(frame.pool.radiance[:, slot]) for slot in range(8)])
        halves = [_image(half) for half in (frame.reference.half_a, frame.reference.half_b)]
        write_frame(folder, frame.index, gbuffer, {"path": pool}, *halves)
    header = Header(
        name=folder.name,
        scene=folder.name,
        sampler="procedural",
        height=side,
        width=side,
        frames=frames,
        reference_spp=(64,) * frames,
        sample_ms=2.0,
        device="another machine",
    )
    write_header(folder, header)
    return folder


def _image(tensor: Tensor) -> NDArray[np.float32]:
    return tensor[0].permute(1, 2, 0).numpy()
