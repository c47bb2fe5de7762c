"""OIDN's training images: one EXR a feature, with the samples per pixel in its name.

`NAME_0001spp.hdr.exr` is a noisy image, `NAME_ref.hdr.exr` (or `reference`, `gt`, `target`, or else
the most samples) its reference; `.alb.exr` and `.nrm.exr` beside it are albedo and normal (Intel,
Open Image Denoise, doc/training.md). NAME with its trailing digits taken off is the clip, the
digits are the frame: view0001, view0002, ... NAME without digits is a clip of one frame.

Only images of 1 spp are samples, for a mean of four cannot be taken apart. Differs from OIDN: NAME
may end in `_seed3`, since several 1-spp images of a frame must be told apart; two references of one
spp and different seeds are taken for the two halves of a reference. Negative radiance stays.

Albedo and normal are those of the first sample, never of the reference, which knows more than a
renderer does before it traces. As in OIDN, albedo is clipped to [0, 1] and normals are made unit
vectors; of which space they are, the format does not say. It has neither depth nor motion.
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
    consecutive,
)

LAYOUT = "NAME0000_0001spp.hdr.exr with .alb.exr and .nrm.exr beside it, NAME0000_ref.hdr.exr"
IMAGE = re.compile(
    r"(?P<name>.+?)(?:_seed(?P<seed>\d+))?_(?:(?P<spp>\d+)(?:spp)?|ref|reference|gt|target)"
    r"\.(?P<feature>hdr|ldr|alb|nrm)\.exr"
)
FEATURES = {"albedo": "alb", "normal": "nrm"}  # by view buffer


@dataclass
class _Frame:
    """The files of one frame: by seed and spp, which is None for a reference named so."""

    images: dict[str, dict[tuple[int, int | None], Path]] = field(
        default_factory=lambda: defaultdict(dict)
    )

    @property
    def samples(self) -> list[tuple[int, int | None]]:
        """Its 1-spp images, in order of their seeds."""
        return sorted(key for key in self.images["hdr"] if key[1] == 1)

    @property
    def references(self) -> list[tuple[int, int | None]]:
        """Its references, in order of their seeds: those named so, or else those of most spp."""
        named = sorted(key for key in self.images["hdr"] if key[1] is None)
        most = max((key[1] or 0 for key in self.images["hdr"]), default=0)
        return named or sorted(k for k in self.images["hdr"] if k[1] == most and most > 1)


def sequences(source: Path, wanted: tuple[int, int] | None) -> list[ImportedSequence]:
    """The clips at and below a folder. Raises SourceError."""
    found: dict[tuple[str, ...], dict[int, _Frame]] = defaultdict(lambda: defaultdict(_Frame))
    for path in limits.files(source):
        if match := IMAGE.fullmatch(path.name):
            stem, digits = re.fullmatch(r"(.*?)(\d*)", match["name"]).groups()  # type: ignore[union-attr]
            clip = (*path.relative_to(source).parent.parts, stem.rstrip("_-. "))
            images = found[clip][int(digits or 0)].images[match["feature"]]
            key = (int(match["seed"] or 0), int(match["spp"]) if match["spp"] else None)
            if key in images:
                raise SourceError(f"{path} and {images[key].name} are the same image of one frame")
            images[key] = path
    return [_sequence(source, parts, frames, wanted) for parts, frames in found.items()]


def _sequence(
    source: Path,
    parts: tuple[str, ...],
    frames: Mapping[int, _Frame],
    wanted: tuple[int, int] | None,
) -> ImportedSequence:
    name = clip_name(*parts) if any(parts) else clip_name(source.resolve().name)
    numbers = consecutive(f"clip '{name}'", frames, wanted)
    chosen = {number: frames[number] for number in numbers}
    for number, frame in chosen.items():
        _check(f"clip '{name}', frame {number}", frame)
    buffers = tuple(b for b in FEATURES if all(_beside(f, b) for f in chosen.values()))
    if not buffers:
        raise SourceError(
            f"clip '{name}': not every frame has an albedo or a normal beside its first sample "
            "(.alb.exr, .nrm.exr); a clip needs at least one of them"
        )
    halved = all(_halved(frame) for frame in chosen.values())
    first = chosen[numbers[0]]
    size = exr_size(first.images["hdr"][first.samples[0]])
    lacks = ["normal"] if "normal" in buffers else []
    return ImportedSequence(
        name=name,
        sampler="unknown, imported from OIDN's training images",
        height=size[0],
        width=size[1],
        numbers=numbers,
        counts=tuple(len(frame.samples) for frame in chosen.values()),
        reference_spp=tuple((1 + halved) * (f.references[0][1] or 0) for f in chosen.values()),
        buffers=buffers,
        lacks=tuple([*([] if halved else ["halves"]), *lacks]),
        files=tuple(
            path for f in chosen.values() for kind in f.images.values() for path in kind.values()
        ),
        read=partial(_read, chosen, buffers, size, halved),
    )


def _check(what: str, frame: _Frame) -> None:
    """Raise SourceError where a frame cannot be made of its files."""
    have = ", ".join(sorted(p.name for kind in frame.images.values() for p in kind.values()))
    if not frame.images["hdr"]:
        raise SourceError(f"{what} has no .hdr.exr, and radiance must be linear; it has: {have}")
    if not frame.samples:
        raise SourceError(
            f"{what} has no image of 1 spp, and a mean of more cannot be taken apart into the "
            f"samples that methods buy; it has: {have}"
        )
    if not frame.references:
        raise SourceError(
            f"{what} has no reference, so nothing can be scored on it: expected _ref.hdr.exr, or "
            f"an image of more than 1 spp; it has: {have}"
        )


def _beside(frame: _Frame, buffer: str) -> bool:
    return frame.samples[0] in frame.images[FEATURES[buffer]]


def _halved(frame: _Frame) -> bool:
    return len(frame.references) == 2


def _read(
    frames: Mapping[int, _Frame],
    buffers: tuple[str, ...],
    size: tuple[int, int],
    halved: bool,
    number: int,
    samples: int,
) -> ImportedFrame:
    frame = frames[number]

    def image(feature: str, key: tuple[int, int | None]) -> Pixels:
        path = frame.images[feature][key]
        limits.same_size(path, exr_size(path), size)
        return read_exr(path)

    gbuffer = {buffer: image(FEATURES[buffer], frame.samples[0]) for buffer in buffers}
    if "albedo" in gbuffer:
        gbuffer["albedo"] = np.clip(gbuffer["albedo"], 0, 1)
    if "normal" in gbuffer:
        gbuffer["normal"] = _unit(gbuffer["normal"])
    pool = np.stack([image("hdr", key) for key in frame.samples[:samples]])
    references = [image("hdr", key) for key in frame.references[: 1 + halved]]
    return ImportedFrame(gbuffer, pool, references[0], references[-1])


def _unit(normal: Pixels) -> Pixels:
    """Normals [h w 3] of length one; zero stays zero."""
    normal = normal.astype(np.float32)
    length = np.linalg.norm(normal, axis=-1, keepdims=True)
    return np.asarray(normal / np.where(length > 0, length, 1))
