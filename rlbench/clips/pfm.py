"""Read and write portable float maps (PFM), the images of Intel's oidnDenoise.

A header of three lines, `PF` (3 channels) or `Pf` (1), width and height, and a scale that is
negative for little-endian floats; then rows from the bottom to the top (Debevec, 1997,
https://www.pauldebevec.com/Research/HDR/PFM/).
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from jaxtyping import Float32
from numpy import ndarray as Array

from rlbench.clips.header import MAX_PIXELS, ClipError
from rlbench.system.paths import atomic_write

CHANNELS = {b"PF": 3, b"Pf": 1}
HEADER = re.compile(rb"(PF|Pf)\s+(\d{1,9})\s+(\d{1,9})\s+(-?[\d.]{1,20}(?:[eE]-?\d+)?)\s")


def write_pfm(path: Path, image: Float32[Array, "h w 3"]) -> None:
    """Write a colour image as little-endian floats, atomically."""
    height, width, _ = image.shape
    with atomic_write(path) as temporary:
        pixels = np.ascontiguousarray(image[::-1], "<f4").tobytes()
        temporary.write_bytes(f"PF\n{width} {height}\n-1.0\n".encode() + pixels)


def read_pfm(path: Path) -> Float32[Array, "h w c"]:
    """The image with its first row at the top; the size of the scale is ignored.

    Raises ClipError for a file that is no PFM, or whose pixels are not those of its header.
    """
    content = path.read_bytes()
    found = HEADER.match(content)
    if not content:
        raise ClipError(f"{path} is empty")
    if found is None:
        raise ClipError(f"{path} is no PFM: it begins with {content[:12]!r}, expected PF or Pf")
    channels, width, height = CHANNELS[found[1]], int(found[2]), int(found[3])
    size, stored = 4 * channels * width * height, len(content) - found.end()
    if not 0 < width * height <= MAX_PIXELS or stored != size:
        raise ClipError(
            f"{path} claims {width} x {height} pixels of {channels} channels, {size} bytes, and "
            f"holds {stored}; from 1 to {MAX_PIXELS} pixels are read"
        )
    order = "<f4" if found[4].startswith(b"-") else ">f4"
    pixels = np.frombuffer(content, order, offset=found.end()).reshape(height, width, channels)
    return np.ascontiguousarray(pixels[::-1], np.float32)
