"""Read one frame of a dump: its images, converted to the conventions of a clip."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import count
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from rlbench.clips.importers import limits
from rlbench.clips.importers.conversions import (
    convert_albedo,
    convert_depth,
    convert_motion,
    convert_normal,
    decode_curve,
    separate_samples,
)
from rlbench.clips.importers.image_files import exr_size, has_channels, list_channels, read_exr
from rlbench.clips.importers.layout import Image, Layout
from rlbench.clips.importers.sequence import ImportedFrame, Pixels, SourceError

__all__ = ["CHANNELS", "FrameFiles", "count_samples", "image_size", "read_frame"]

RGB, XYZ = ("*.R", "*.G", "*.B"), ("*.X", "*.Y", "*.Z")
CHANNELS = {  # usual names, the preferred ones first
    "albedo": (RGB,),
    "normal": (XYZ, RGB),
    "depth": (("*.Z",), ("*.V",), ("*.Y",), ("*.R",), ("*.T",)),
    "motion": (("*.X", "*.Y"), ("*.R", "*.G"), ("*.U", "*.V")),
}
FLIPS = {"no": (), "vertical": (0,), "horizontal": (1,), "both": (0, 1)}
SAMPLE = "{sample}"  # in the name of a channel or a part


@dataclass(frozen=True)
class FrameFiles:
    """The files of one frame, by image: samples in order, halves, or one of a buffer."""

    images: Mapping[str, Sequence[Path]]
    reference_spp: int  # of one reference; 0: unknown

    @property
    def paths(self) -> list[Path]:
        """All files."""
        return list(dict.fromkeys(path for paths in self.images.values() for path in paths))

    def without(self, names: Sequence[str]) -> FrameFiles:
        """The files of all other images."""
        return replace(self, images={k: v for k, v in self.images.items() if k not in names})

    def with_references(self, count: int) -> FrameFiles:
        """The files with the first `count` references alone."""
        return replace(self, images={**self.images, "reference": self.images["reference"][:count]})


def count_samples(files: FrameFiles, layout: Layout) -> int:
    """The 1-spp images of a frame, in files of their own or in channels of one.

    Raises SourceError.
    """
    paths, image = files.images["radiance"], layout.radiance
    if SAMPLE not in image.part + "".join(image.channel_names):
        return len(paths)
    parts = list_channels(paths[0])
    names = {name for part, channels in parts.items() for name in channels}
    names |= {f"{part}.{name}" for part, channels in parts.items() for name in channels}
    first = image.channel_names[0] if image.channel_names else image.part
    known = names if image.channel_names else set(parts)
    return next(slot for slot in count() if first.replace(SAMPLE, str(slot)) not in known)


def has_image(files: FrameFiles, name: str, layout: Layout) -> bool:
    """Whether the first file of an image has its channels. Raises SourceError."""
    image = layout.images[name]
    return has_channels(files.images[name][0], _channels(name, image), image.part)


def image_size(files: FrameFiles, name: str, layout: Layout) -> tuple[int, int]:
    """Height and width of the first image of a kind, pixels. Raises SourceError."""
    return exr_size(files.images[name][0])


def read_frame(
    frames: Mapping[int, FrameFiles],
    layout: Layout,
    size: tuple[int, int],
    source: Path,
    first: int,
    number: int,
    samples: int,
) -> ImportedFrame:
    """Frame `number` with the given number of samples. Raises SourceError.

    `first` is the first frame of the dump, to which the first matrix of a camera file belongs.
    """
    files = frames[number]
    gbuffer: dict[str, Pixels] = {}
    if layout.albedo and (stored := _read(files, "albedo", layout.albedo, size)) is not None:
        gbuffer["albedo"] = convert_albedo(stored, layout.albedo)
    if layout.normal and (stored := _read(files, "normal", layout.normal, size)) is not None:
        rotation = None
        if layout.normal.space == "view" and layout.normal.camera:
            rotation = _read_rotation(source / layout.normal.camera, number - first)
        gbuffer["normal"] = convert_normal(stored, layout.normal, rotation)
    if layout.depth and (stored := _read(files, "depth", layout.depth, size)) is not None:
        gbuffer["depth"] = convert_depth(stored, layout.depth)
    if layout.motion and (stored := _read(files, "motion", layout.motion, size)) is not None:
        gbuffer["motion"] = _read_motion(stored, frames, layout, size, number)
    pool = _read_pool(files, layout, size, samples, gbuffer)
    halves = [
        _modulate(decode_curve(image, layout.reference.encoding), layout.reference, gbuffer)
        for image in _read_all(files, "reference", layout.reference, size)
    ]
    return ImportedFrame(gbuffer, pool, halves[0], halves[len(halves) == 2])


def _read_pool(
    files: FrameFiles,
    layout: Layout,
    size: tuple[int, int],
    samples: int,
    gbuffer: Mapping[str, Pixels],
) -> Pixels:
    """The samples [s h w 3]: light, times albedo if it is demodulated, and what is added to it."""
    total: Pixels | None = None
    for name, image in (("radiance", layout.radiance), ("specular", layout.specular)):
        if image is None or not files.images.get(name):
            continue
        stored = [
            decode_curve(v, image.encoding) for v in _slots(files, name, image, size, samples)
        ]
        light = separate_samples(stored) if image.samples == "accumulated" else stored
        part = np.stack([_modulate(each, image, gbuffer) for each in light])
        if total is not None and len(part) != len(total):
            raise SourceError(
                f"{files.images[name][0]}: [{name}] has {len(part)} samples, [radiance] has "
                f"{len(total)}"
            )
        total = part if total is None else total + part
    assert total is not None
    if (
        layout.emission
        and (emission := _read(files, "emission", layout.emission, size)) is not None
    ):
        total = total + emission
    return total


def _slots(
    files: FrameFiles, name: str, image: Image, size: tuple[int, int], samples: int
) -> list[Pixels]:
    """The first samples of an image, from files or from channels of one file."""
    if SAMPLE not in image.part + "".join(image.channel_names):
        return _read_all(files, name, image, size, samples)
    path = files.images[name][0]

    def fill(text: str, slot: int) -> str:
        return text.replace(SAMPLE, str(slot))

    return [
        _read_image(
            path,
            ([fill(channel, slot) for channel in image.channel_names],)
            if image.channel_names
            else (RGB, XYZ),
            fill(image.part, slot),
            image.flip,
            size,
        )
        for slot in range(samples)
    ]


def _read(files: FrameFiles, name: str, image: Image, size: tuple[int, int]) -> Pixels | None:
    images = _read_all(files, name, image, size, 1)
    return images[0] if images else None


def _read_all(
    files: FrameFiles, name: str, image: Image, size: tuple[int, int], most: int = 2
) -> list[Pixels]:
    channels = _channels(name, image)
    return [
        _read_image(path, channels, image.part, image.flip, size)
        for path in files.images.get(name, ())[:most]
    ]


def _channels(name: str, image: Image) -> Sequence[Sequence[str]]:
    """The names of the channels of an image, or the usual ones, as alternatives."""
    return (image.channel_names,) if image.channel_names else CHANNELS.get(name, (RGB, XYZ))


def _read_image(
    path: Path,
    channels: Sequence[Sequence[str]],
    part: str,
    flip: str,
    size: tuple[int, int],
) -> Pixels:
    pixels = read_exr(path, channels, part)
    limits.check_same_size(path, pixels.shape[:2], size)
    return np.flip(pixels, FLIPS[flip])


def _read_motion(
    stored: Pixels,
    frames: Mapping[int, FrameFiles],
    layout: Layout,
    size: tuple[int, int],
    number: int,
) -> Pixels:
    """Motion to the previous frame; zero in a first frame whose motion is in no file."""
    assert layout.motion is not None
    if layout.motion.points.endswith("previous"):
        return convert_motion(stored, layout.motion)
    if number - 1 not in frames:
        return np.zeros((*size, 2), np.float32)
    previous = _read(frames[number - 1], "motion", layout.motion, size)
    return convert_motion(stored, layout.motion, previous)


def _modulate(light: Pixels, image: Image, gbuffer: Mapping[str, Pixels]) -> Pixels:
    """Light times albedo where it is demodulated. Raises SourceError without albedo."""
    if not getattr(image, "demodulated", False):
        return light
    if "albedo" not in gbuffer:
        raise SourceError("demodulated light needs albedo, and the dump has no file of [albedo]")
    return light * gbuffer["albedo"]


def _read_rotation(path: Path, index: int) -> Float[Array, "3 3"]:
    """The rotation of one camera-to-world matrix in a JSON file. Raises SourceError."""
    try:
        document = json.loads(path.read_text())
        matrices = document["camera_to_world"] if isinstance(document, dict) else document
        matrix = np.array(matrices[index], np.float64)
    except (OSError, ValueError, TypeError, KeyError, IndexError) as error:
        raise SourceError(
            f"{path} holds no camera-to-world matrix {index}: expected a JSON list of 4 x 4 "
            f"matrices, one a frame ({error!r})"
        ) from error
    if matrix.shape not in ((4, 4), (3, 3)) or not np.isfinite(matrix).all():
        raise SourceError(f"{path}: matrix {index} is of shape {matrix.shape}, expected 4 x 4")
    columns = matrix[:3, :3]
    return np.asarray(columns / np.linalg.norm(columns, axis=0))
