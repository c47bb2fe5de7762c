"""Clip folders of the procedural world, as if another machine had rendered them."""

from __future__ import annotations

from pathlib import Path

from rlbench.clips.procedural.folder import write_procedural_clip


def write_world(folder: Path, seed: int = 0, side: int = 48, frames: int = 3) -> Path:
    """Write a complete clip of a moving world with `side` x `side` pixels."""
    times = {"sample_ms": 2.0, "device": "another machine"}
    return write_procedural_clip(folder, seed, side, frames, **times)
