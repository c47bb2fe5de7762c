"""The video of the how-to on denoising an animation: python docs/denoise_video.py NOISY OIDN OURS

Reads three folders of EXR files by Blender, and writes docs/results/denoise.webp, and a picture of
one row of pixels through time, docs/results/denoise-slice.png.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from rlbench.clips.image_files import read_exr
from rlbench.ops.color import encode_srgb

FOLDER = Path(__file__).parent / "results"
TITLES = ("4 samples a pixel", "oidn, frame by frame", "accumulate/tuned")
COMBINED = (("*.Combined.R", "*.Combined.G", "*.Combined.B"),)
EXPOSURE, BAR, ROW, ZOOM = 1.2, 18, 70, 4


def read_frames(folder: str) -> list[NDArray[np.uint8]]:
    """The frames of a folder as 8-bit sRGB."""
    images = (read_exr(path, COMBINED) for path in sorted(Path(folder).glob("*.exr")))
    shown = (encode_srgb((EXPOSURE * torch.from_numpy(each)).clamp(0, 1)) for each in images)
    return [(255 * each + 0.5).byte().numpy() for each in shown]


def with_titles(images: list[NDArray[np.uint8]]) -> Image.Image:
    """Images beside each other, each under its title."""
    row = Image.fromarray(np.concatenate(images, 1))
    page = Image.new("RGB", (row.width, row.height + BAR), "white")
    page.paste(row, (0, BAR))
    for number, title in enumerate(TITLES):
        left = number * images[0].shape[1] + 4
        ImageDraw.Draw(page).text((left, 3), title, fill="black")
    return page


def main() -> None:
    """Write both pictures."""
    columns = [read_frames(folder) for folder in sys.argv[1:4]]
    pages = [with_titles(list(frames)) for frames in zip(*columns, strict=True)]
    pages[0].save(
        FOLDER / "denoise.webp",
        save_all=True,
        append_images=pages[1:],
        duration=100,
        loop=0,
        quality=70,
        method=6,
    )
    slices = [np.repeat(np.stack([f[ROW] for f in frames]), ZOOM, 0) for frames in columns]
    with_titles(slices).save(FOLDER / "denoise-slice.png", optimize=True)


if __name__ == "__main__":
    main()
