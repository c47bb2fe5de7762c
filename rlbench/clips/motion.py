"""How far pixels move from frame to frame in clips."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from rlbench.clips.stored import open_clip

PERCENTILES = (50, 95)


def measure_motion(folders: Iterable[Path]) -> tuple[float, float]:
    """Median and 95th percentile of the length of motion over all pixels, in pixels a frame.

    First frames and cuts are left out, since nothing has moved there. A static clip counts as 0.
    """
    lengths = [_lengths(folder) for folder in folders]
    median, high = np.percentile(np.concatenate(lengths), PERCENTILES)
    return float(median), float(high)


def _lengths(folder: Path) -> np.ndarray:
    clip = open_clip(folder, frozenset({"motion"}), max_samples=1)
    header = clip.header
    frames = [frame for frame in range(1, header.frames) if frame not in header.cuts]
    if header.static:
        return np.zeros(len(frames) * header.height * header.width, np.float32)
    motions = [clip.arrays.gbuffer(frame, ["motion"])["motion"] for frame in frames]
    return np.concatenate([np.hypot(motion[0], motion[1]).ravel() for motion in motions])
