"""OIDN's training images: one EXR per feature, with the samples per pixel in its name.

`NAME_0001spp.hdr.exr` is a noisy image. Its reference is `NAME_ref.hdr.exr` (or `reference`, `gt`,
`target`, or else the image with the most samples). `.alb.exr` and `.nrm.exr` with the same name are
albedo and normal (Intel, Open Image Denoise, doc/training.md). NAME without its trailing digits is
the clip, and the digits are the frame: view0001, view0002, ... NAME without digits is a clip of one
frame.

Only 1-spp images are samples, because a mean of four cannot be separated. Differs from OIDN: NAME
may end in `_seed3`, to distinguish several 1-spp images of a frame; two references with the same
spp and different seeds are the two halves of a reference. Negative radiance is kept.

Albedo and normal come from the first sample, never from the reference, which has information that
a renderer does not have before it traces. As in OIDN, albedo is clipped to [0, 1] and normals are
normalized; the format does not specify the space of normals. It has neither depth nor motion.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np

from rlbench.clips.importers import limits
from rlbench.clips.importers.image_files import exr_size, read_exr
from rlbench.clips.importers.sequence import (
    ImportedFrame,
    ImportedSequence,
    Pixels,
    SourceError,
    clip_name,
    select_frames,
)

LAYOUT = "NAME0000_0001spp.hdr.exr with .alb.exr and .nrm.exr beside it, NAME0000_ref.hdr.exr"
IMAGE = re.compile(
    r"(?P<name>.+?)(?:_seed(?P<seed>\d+))?_(?:(?P<spp>\d+)(?:spp)?|ref|reference|gt|target)"
    r"\.(?P<feature>hdr|ldr|alb|nrm)\.exr"
)
FEATURES = {"albedo": "alb", "normal": "nrm"}  # by buffer
ImageKey = tuple[int, int | None]  # seed and spp; spp is None for a file named as reference


@dataclass
class _Frame:
    """The files of one frame, by feature and by seed and spp."""

    images: dict[str, dict[ImageKey, Path]] = field(default_factory=lambda: defaultdict(dict))

    @property
    def samples(self) -> list[ImageKey]:
        """The 1-spp images, sorted by seed."""
        return sorted(key for key in self.images["hdr"] if key[1] == 1)

    @property
    def references(self) -> list[ImageKey]:
        """The references, sorted by seed: files named so, or else the images with the most spp."""
        named = sorted(key for key in self.images["hdr"] if key[1] is None)
        most = max((key[1] or 0 for key in self.images["hdr"]), default=0)
        return named or sorted(k for k in self.images["hdr"] if k[1] == most and most > 1)


def find_sequences(source: Path, selection: tuple[int, int] | None) -> list[ImportedSequence]:
    """The sequences in a folder and its subfolders. Raises SourceError."""
    clips: dict[tuple[str, ...], dict[int, _Frame]] = defaultdict(lambda: defaultdict(_Frame))
    for path in limits.list_files(source):
        if match := IMAGE.fullmatch(path.name):
            stem, digits = re.fullmatch(r"(.*?)(\d*)", match["name"]).groups()  # type: ignore[union-attr]
            clip = (*path.relative_to(source).parent.parts, stem.rstrip("_-. "))
            images = clips[clip][int(digits or 0)].images[match["feature"]]
            key = (int(match["seed"] or 0), int(match["spp"]) if match["spp"] else None)
            if key in images:
                raise SourceError(f"{path} and {images[key].name} are the same image of one frame")
            images[key] = path
    return [_sequence(source, parts, frames, selection) for parts, frames in clips.items()]


def _sequence(
    source: Path,
    parts: tuple[str, ...],
    frames: Mapping[int, _Frame],
    selection: tuple[int, int] | None,
) -> ImportedSequence:
    name = clip_name(*parts) if any(parts) else clip_name(source.resolve().name)
    numbers = select_frames(f"clip '{name}'", frames, selection)
    selected = {number: frames[number] for number in numbers}
    for number, frame in selected.items():
        _check(f"clip '{name}', frame {number}", frame)
    buffers = tuple(b for b in FEATURES if all(_has_buffer(f, b) for f in selected.values()))
    if not buffers:
        raise SourceError(
            f"clip '{name}': not every frame has an albedo or a normal for its first sample "
            "(.alb.exr, .nrm.exr); a clip needs at least one of them"
        )
    has_halves = all(_has_halves(frame) for frame in selected.values())
    first = selected[numbers[0]]
    size = exr_size(first.images["hdr"][first.samples[0]])
    limitations = ["normal"] if "normal" in buffers else []  # their space is unknown
    return ImportedSequence(
        name=name,
        sampler="unknown, imported from OIDN's training images",
        height=size[0],
        width=size[1],
        numbers=numbers,
        counts=tuple(len(frame.samples) for frame in selected.values()),
        reference_spp=tuple(
            (1 + has_halves) * (f.references[0][1] or 0) for f in selected.values()
        ),
        buffers=buffers,
        limitations=tuple([*([] if has_halves else ["halves"]), *limitations]),
        files=tuple(
            path for f in selected.values() for kind in f.images.values() for path in kind.values()
        ),
        read=partial(_read, selected, buffers, size, has_halves),
    )


def _check(label: str, frame: _Frame) -> None:
    """Raise SourceError where the files of a frame have no radiance, samples or reference."""
    content = ", ".join(sorted(p.name for kind in frame.images.values() for p in kind.values()))
    if not frame.images["hdr"]:
        raise SourceError(
            f"{label} has no .hdr.exr, and radiance must be linear; it has: {content}"
        )
    if not frame.samples:
        raise SourceError(
            f"{label} has no image of 1 spp, and a mean of more cannot be separated into the "
            f"samples that methods draw; it has: {content}"
        )
    if not frame.references:
        raise SourceError(
            f"{label} has no reference, so nothing can be scored on it: expected _ref.hdr.exr, or "
            f"an image of more than 1 spp; it has: {content}"
        )


def _has_buffer(frame: _Frame, buffer: str) -> bool:
    return frame.samples[0] in frame.images[FEATURES[buffer]]


def _has_halves(frame: _Frame) -> bool:
    return len(frame.references) == 2


def _read(
    frames: Mapping[int, _Frame],
    buffers: tuple[str, ...],
    size: tuple[int, int],
    has_halves: bool,
    number: int,
    samples: int,
) -> ImportedFrame:
    frame = frames[number]

    def read(feature: str, key: ImageKey) -> Pixels:
        path = frame.images[feature][key]
        limits.check_same_size(path, exr_size(path), size)
        return read_exr(path)

    gbuffer = {buffer: read(FEATURES[buffer], frame.samples[0]) for buffer in buffers}
    if "albedo" in gbuffer:
        gbuffer["albedo"] = np.clip(gbuffer["albedo"], 0, 1)
    if "normal" in gbuffer:
        gbuffer["normal"] = _normalize(gbuffer["normal"])
    pool = np.stack([read("hdr", key) for key in frame.samples[:samples]])
    references = [read("hdr", key) for key in frame.references[: 1 + has_halves]]
    return ImportedFrame(gbuffer, pool, references[0], references[-1])


def _normalize(normal: Pixels) -> Pixels:
    """Normals [h w 3] of unit length; zero stays zero."""
    normal = normal.astype(np.float32)
    length = np.linalg.norm(normal, axis=-1, keepdims=True)
    return np.asarray(normal / np.where(length > 0, length, 1))
