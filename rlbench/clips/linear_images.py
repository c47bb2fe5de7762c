"""Image files that belong to no run: each read as linear radiance, or several as a clip to look at.

EXR and PFM hold linear radiance, and stay as they are, but that an EXR of other chromaticities
becomes Rec. 709. PNG holds 8-bit sRGB, and is decoded.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float32
from numpy import ndarray as Array

from rlbench.clips.header import ClipError
from rlbench.clips.image_files import Channels, read_exr_image, read_png, to_rec709
from rlbench.clips.pfm import read_pfm
from rlbench.errors import RlbenchError, SourceError
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
