"""EXR files of the tests, by the library alone: channels, images [h w c] and parts."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR

Planes = dict[str, np.ndarray]
LAYOUT = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}


def write_file(path: Path, parts: dict[str, Planes], **header: Any) -> Path:
    """A file of scan lines; several parts make a multi-part file. `header` has more attributes."""
    path.parent.mkdir(parents=True, exist_ok=True)
    planes = {
        part: {name: np.ascontiguousarray(plane) for name, plane in channels.items()}
        for part, channels in parts.items()
    }
    if len(planes) == 1:
        file = OpenEXR.File(LAYOUT | header, next(iter(planes.values())))
    else:
        file = OpenEXR.File([OpenEXR.Part(LAYOUT | header, p, name) for name, p in planes.items()])
    file.write(str(path))
    return path


def write_image(path: Path, image: np.ndarray, names: Sequence[str] = "RGB", **header: Any) -> Path:
    """A file of one image [h w c] with these channels."""
    return write_file(path, {"": {name: image[..., k] for k, name in enumerate(names)}}, **header)


def read_parts(path: Path) -> list[tuple[dict[str, Any], Planes]]:
    """The attributes and the channels of all parts."""
    with OpenEXR.File(str(path), separate_channels=True) as file:
        return [
            (
                {name: value for name, value in part.header.items() if name != "channels"},
                {name: channel.pixels.copy() for name, channel in part.channels.items()},
            )
            for part in file.parts
        ]


def read_planes(path: Path) -> Planes:
    """The channels of the first part."""
    return read_parts(path)[0][1]


def read_image(path: Path, prefix: str = "") -> np.ndarray:
    """The colours of the first part, [h w 3]."""
    planes = read_planes(path)
    return np.stack([planes[f"{prefix}{name}"] for name in "RGB"], -1)
