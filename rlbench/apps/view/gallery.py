"""Image files that belong to no run, as a clip to look at."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float32
from numpy import ndarray as Array

from rlbench.benchmark.shown_clips import ShownClip, ShownImages
from rlbench.clips.linear_images import ANY_IMAGE, ANY_MODE, ENCODINGS, LooseImageError, read_linear


def read_gallery(
    files: Sequence[Path], layer: str = "", on_image: Callable[[], None] = lambda: None
) -> tuple[ShownClip, list[str]]:
    """The images of files as a clip of one frame without a reference, and remarks on them.

    Images are named after their files. Raises LooseImageError where a file cannot be read, or where
    sizes differ.
    """
    names = _short_names(files)
    images, remarks = list[Float32[Array, "3 h w"]](), list[str]()
    for name, file in zip(names, files, strict=True):
        pixels = read_linear(file, ANY_IMAGE, ANY_MODE, layer)
        image = np.moveaxis(np.broadcast_to(pixels, (*pixels.shape[:2], 3)), -1, 0)
        if images and image.shape != images[0].shape:
            (_, h, w), (_, first_h, first_w) = image.shape, images[0].shape
            raise LooseImageError(
                f"{file} has {w} x {h} pixels, and {files[0]} {first_w} x {first_h}. Images of one "
                "size are compared; crop or scale them first"
            )
        images.append(image)
        if count := int((~np.isfinite(image).all(axis=0)).sum()):
            remarks.append(f"{name}: pixels that are NaN or infinite, shown in magenta: {count}")
        on_image()
    suffixes = {file.suffix.lower() for file in files}
    if len(suffixes) > 1 and ".png" in suffixes:
        remarks.append(
            f"files of two kinds: {'; '.join(ENCODINGS[each] for each in sorted(suffixes))}"
        )
    _, height, width = images[0].shape
    none = np.zeros((0, 3, height, width), np.float32)
    outputs = tuple(
        ShownImages(
            method=name, target_spp=0.0, seed=0, device="", frames=image[None], counts=none[:, 0]
        )
        for name, image in zip(names, images, strict=True)
    )
    clip = ShownClip(
        name="images",
        scene="images",
        fps=1.0,
        cuts=(),
        light_changes=(),
        reference=none,
        buffers={},
        images=outputs,
    )
    return clip, remarks


def _short_names(files: Sequence[Path]) -> list[str]:
    """The names of files; with as many folders as tell them apart. Raises LooseImageError.

    >>> _short_names([Path("x/a/1.exr"), Path("x/b/1.exr")])
    ['a/1.exr', 'b/1.exr']
    """
    paths = [Path(os.path.abspath(file)) for file in files]
    if twice := [
        str(file) for file, path in zip(files, paths, strict=True) if paths.count(path) > 1
    ]:
        raise LooseImageError(f"{twice[0]} is named twice")
    for length in range(1, max(len(path.parts) for path in paths) + 1):
        names = ["/".join(path.parts[-length:]) for path in paths]
        if len(set(names)) == len(names):
            return names
    raise AssertionError  # different paths have different names
