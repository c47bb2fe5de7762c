"""A dump of one file a frame and image kind, for changing single values of it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import OpenEXR

H, W = 16, 24
LAYOUT = """
[radiance]
files = "s{sample}/b.{frame}.exr"
[reference]
files = "r{half}/b.{frame}.exr"
[albedo]
files = "aov.{frame}.exr"
channels = ["albedo.R", "albedo.G", "albedo.B"]
[normal]
files = "aov.{frame}.exr"
channels = ["normal.X", "normal.Y", "normal.Z"]
[depth]
files = "aov.{frame}.exr"
channels = ["depth.Z"]
[motion]
files = "aov.{frame}.exr"
channels = ["motion.X", "motion.Y"]
"""
Planes = dict[str, np.ndarray]


def rgb(value: float, prefix: str = "", letters: str = "RGB") -> Planes:
    """Constant channels."""
    return {f"{prefix}{c}": np.full((H, W), value, np.float32) for c in letters}


def aovs() -> Planes:
    """Buffers whose values differ from pixel to pixel where a neighbour's would be taken."""
    y, x = np.mgrid[:H, :W].astype(np.float32)
    angle = (x + y) / 100
    zero = np.zeros((H, W), np.float32)
    return {
        **{f"albedo.{c}": 0.2 + (x + 2 * y) / 100 for c in "RGB"},
        "normal.X": np.cos(angle),
        "normal.Y": np.sin(angle),
        "normal.Z": zero,
        "depth.Z": 2 + x + y / 10,
        "motion.X": 1 + x / 10,
        "motion.Y": -1 + y / 10,
    }


def write(path: Path, planes: Planes, **header) -> None:
    """A file of scan lines; `header` has more attributes."""
    path.parent.mkdir(parents=True, exist_ok=True)
    attributes = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(attributes | header, planes).write(str(path))


def write_dump(folder: Path, frames: tuple[int, ...] = (1001, 1002, 1003)) -> Path:
    """A dump of two samples and two halves; its layout lies beside it, as layout.toml."""
    dump = folder / "dump"
    for frame in frames:
        for place in ("s0", "s1", "rA", "rB"):
            write(dump / place / f"b.{frame}.exr", rgb(0.5))
        write(dump / f"aov.{frame}.exr", aovs())
    (folder / "layout.toml").write_text(LAYOUT)
    return dump
