"""Image files that belong to no run: each read as linear radiance, or several as a clip to look at.

EXR and PFM hold linear radiance, and stay as they are, but that an EXR of other chromaticities
becomes Rec. 709. PNG holds 8-bit sRGB, and is decoded.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float32
from numpy import ndarray as Array

from rlbench.benchmark.shown_clips import ShownClip, ShownImages
from rlbench.clips.header import ClipError
from rlbench.clips.importers.image_files import Channels, read_exr_image, read_png, to_rec709
from rlbench.clips.importers.sequence import SourceError
from rlbench.clips.pfm import read_pfm
from rlbench.errors import RlbenchError
from rlbench.ops.color import decode_srgb

ENCODINGS = {
    ".exr": "EXR, linear radiance",
    ".pfm": "PFM, linear radiance",
    ".png": "PNG, 8-bit sRGB, decoded: clipped at display white",
}
COMBINED = ("*.Combined.R", "*.Combined.G", "*.Combined.B")  # Blender's name of the image
RGB = (("R", "G", "B"), COMBINED, ("*.R", "*.G", "*.B"))
ANY_IMAGE = (*RGB, ("Y",), ("*.Y",))
ANY_MODE = ("RGB", "RGBA", "P", "L", "LA", "1")  # of PNG; alpha is left out


class LooseImageError(RlbenchError, ValueError):
    """Image files that cannot be read, or not be compared with each other."""


def read_linear(
    file: Path,
    alternatives: Sequence[Sequence[str]] = RGB,
    modes: Sequence[str] = ("RGB",),
    layer: str = "",
) -> Float32[Array, "h w c"]:
    """The linear radiance of a file; `alternatives` and `layer` choose channels of an EXR.

    `modes` are those of PNG that are read. A PFM or an EXR of luminance has one channel. Raises
    LooseImageError.
    """
    suffix = file.suffix.lower()
    if suffix not in ENCODINGS:
        raise LooseImageError(f"{file} is none of {', '.join(ENCODINGS)}, which are read")
    if not file.is_file():
        raise LooseImageError(f"there is no file {file}")
    try:
        if suffix == ".png":
            display = torch.from_numpy(read_png(file, modes).astype(np.float32) / 255)
            return decode_srgb(display).numpy()
        if suffix == ".pfm":
            return read_pfm(file)
        image = read_exr_image(file, Channels(alternatives, layer=layer))
        pixels, _ = to_rec709(file, image.pixels, image.header)
        return pixels.astype(np.float32)
    except (SourceError, ClipError) as error:
        raise LooseImageError(str(error)) from error
    except OSError as error:
        raise LooseImageError(f"{file} cannot be read: {error.strerror or error}") from error


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
