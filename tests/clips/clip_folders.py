"""A small clip of random images on disk."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import OpenEXR

from rlbench.clips import Header, write_frame, write_header
from rlbench.clips.exr import write_exr

H, W, FRAMES, STORED = 5, 7, 2, 4
HEADER = Header(
    name="street/mini",
    scene="street",
    sampler="by hand",
    height=H,
    width=W,
    frames=FRAMES,
    exposure=0.5,
    pool_spp=STORED,
    reference_spp=(64, 32),
)


def content(index: int) -> dict[str, np.ndarray]:
    """All images of one frame, in double precision, h w c."""
    rng = np.random.default_rng(index)
    depth = rng.uniform(1, 1e4, (H, W, 1))
    depth[0, 0] = np.inf
    return {
        "albedo": rng.random((H, W, 3)),
        "normal": rng.uniform(-1, 1, (H, W, 3)),
        "depth": depth,
        "motion": rng.normal(0, 100, (H, W, 2)),
        "pool": rng.exponential(1.0, (STORED, H, W, 3)),
        "a": rng.exponential(1.0, (H, W, 3)),
        "b": rng.exponential(1.0, (H, W, 3)),
    }


def write_clip(folder: Path, header: Header = HEADER) -> Path:
    for index in range(header.frames):
        images = content(index)
        gbuffer = {name: images[name] for name in header.buffers}
        write_frame(folder, index, gbuffer, {"path": images["pool"]}, images["a"], images["b"])
    write_header(folder, header)
    return folder


def touch_up(path: Path, channel: str, value: float) -> None:
    """Set one value of a channel of a file."""
    with OpenEXR.File(str(path), separate_channels=True) as file:
        planes = {name: np.array(c.pixels) for name, c in file.channels().items()}
    planes[channel][1, 2] = value
    write_exr(path, planes)


def edit(folder: Path, old: str, new: str) -> None:
    """Replace a piece of clip.toml."""
    text = (folder / "clip.toml").read_text("utf-8")
    assert old in text
    (folder / "clip.toml").write_text(text.replace(old, new, 1), "utf-8")
