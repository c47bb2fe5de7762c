"""The frames of a shot in files: which they are, how one is read, and where its image goes.

Layouts are those of `rlbench import`, or files are loose (`loose.py`). Here the radiance of a
layout is the mean of any number of samples, there is no reference, and the denoised radiance takes
the place of the mean's channels in a copy of its file.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import takewhile
from pathlib import Path
from typing import Any

import numpy as np

from rlbench.apps.dumps.denoising import UNKNOWN_SPP, WARM_UP
from rlbench.apps.dumps.denoising.exr_copy import NewPixels, replace_channels
from rlbench.apps.dumps.denoising.loose import is_blender, match_loose_images, parse_loose_image
from rlbench.apps.dumps.denoising.passes import (
    DenoisedParts,
    LightPass,
    Part,
    find_passes,
    read_parts,
    to_tensor,
)
from rlbench.apps.dumps.importers import limits
from rlbench.apps.dumps.importers.dump import Clips, build_sequences, match_files
from rlbench.apps.dumps.importers.dump_frame import FLIPS, image_channels
from rlbench.apps.dumps.importers.formats import FORMATS
from rlbench.apps.dumps.importers.layout import Layout, Reference, read_layout
from rlbench.apps.dumps.importers.sequence import ImportedSequence, select_frames
from rlbench.apps.dumps.importers.sky import add_sky_motion
from rlbench.apps.dumps.importers.writer import MAX_EXPOSURE_FRAMES
from rlbench.clips.exr import ExrHeaderError
from rlbench.clips.exr_attributes import read_strings
from rlbench.clips.image_files import find_channels, read_exr_image
from rlbench.clips.primaries import Chromaticities, format_chromaticities
from rlbench.denoise import NoisyFrame, estimate_exposure
from rlbench.errors import SourceError
from rlbench.frames import GBuffer

__all__ = ["GapError", "NoMotionError", "NoisySequence", "find_noisy_sequences"]

SAMPLES_ATTRIBUTE = re.compile(r"cycles\..*\.samples")  # by Blender, for each view layer
NO_MOTION = "no motion"  # the limitation of a sequence with motion of 0 in place of its own
WIDTHS = range(1, 7)  # digits of samples per pixel in a file name


class GapError(SourceError):
    """Frames between others that are missing, and that a memory needs."""


class NoMotionError(SourceError):
    """A sequence without the motion that a memory needs."""


@dataclass(frozen=True)
class NoisySequence:
    """The frames of one shot, read one by one."""

    source: Path
    sequence: ImportedSequence
    layout: Layout
    spp: float | None  # samples per pixel of every frame; None: as the files say
    is_static: bool = False  # nothing moves, whatever the files say
    start: int = 0  # index of the first frame that is written; those before are for the memory
    overview: tuple[Path, ...] = ()  # means of up to 8 frames of the whole shot
    frames: tuple[int, int] | None = None  # the piece of the shot; None: all of it
    passes: tuple[LightPass, ...] = ()  # that are denoised too

    def __len__(self) -> int:
        """Number of frames."""
        return len(self.sequence.numbers)

    @property
    def name(self) -> str:
        """The name of the shot."""
        return self.sequence.name

    @property
    def notes(self) -> list[str]:
        """What the files lack, for their user."""
        missing = [each for each in self.sequence.limitations if each.startswith("no ")]
        lines = [f"{each}: a constant stands in" for each in missing if each != NO_MOTION]
        if "flow" in self.sequence.limitations:
            lines.append("no motion: optical flow of albedo stands in")
        if primaries := self.primaries:
            lines.append(f"chromaticities are kept: {format_chromaticities(primaries)}")
        if "sky motion" in self.sequence.limitations:
            lines.append("motion of the sky is unknown, so the sky has no history")
        return lines

    @property
    def piece(self) -> str:
        """What tells a piece of the shot from others in names of files; empty for the whole."""
        return f".{self.frames[0]}-{self.frames[1]}" if self.frames else ""

    def sources(self, index: int) -> tuple[Path, ...]:
        """The files of a frame."""
        return self.sequence.frame_files[index]

    @property
    def primaries(self) -> Chromaticities | None:
        """What R, G and B of the first frame mean; None for Rec. 709. Raises SourceError."""
        path = self.sequence.radiance[0]
        header, _ = find_channels(path, image_channels("radiance", self.layout))
        try:
            return header.primaries
        except ExrHeaderError as error:
            raise SourceError(f"{path}: {error}") from error

    def output(self, index: int, out: Path) -> Path:
        """The file of a denoised frame: the path of its mean, below another folder."""
        return out / self.sequence.radiance[index].relative_to(self.source)

    def read(self, index: int) -> NoisyFrame:
        """A frame; values that are not finite stay. Raises SourceError."""
        frame = self.sequence.read(self.sequence.numbers[index], 1)
        buffers = {name: to_tensor(pixels) for name, pixels in frame.gbuffer.items()}
        is_static = self.is_static or NO_MOTION in self.sequence.limitations
        return NoisyFrame(
            GBuffer(buffers, static=is_static), to_tensor(frame.pool[0]), self.read_spp(index)
        )

    def read_spp(self, index: int) -> float:
        """Samples per pixel of a frame: as given, as its file says, or else UNKNOWN_SPP."""
        return self.spp or self.find_spp(index) or UNKNOWN_SPP

    def find_spp(self, index: int) -> float | None:
        """Samples per pixel as Blender writes them into a file, None where it does not say them."""
        for name, value in read_strings(self.sequence.radiance[index]):
            if SAMPLES_ATTRIBUTE.fullmatch(name) and value.isdecimal():
                return max(1.0, float(value))
        return None

    def estimate_exposure(self) -> float:
        """The exposure for the means of up to 8 frames of the whole shot. Raises SourceError."""
        channels = image_channels("radiance", self.layout)
        images = (read_exr_image(file, channels).pixels for file in self.overview)
        return estimate_exposure(to_tensor(image)[0] for image in images)

    def read_parts(self, index: int) -> dict[str, Part]:
        """The passes of a frame. Raises SourceError."""
        file, flip = self.sequence.radiance[index], FLIPS[self.layout.radiance.flip]
        return read_parts(file, self.passes, self.sequence.window, flip)

    def write(self, index: int, out: Path, found: DenoisedParts) -> Path:
        """Write a copy of a frame's file with the image in place of the mean, and its parts."""
        source, target = self.sequence.radiance[index], self.output(index, out)
        places = [(image_channels("radiance", self.layout), found.image)]
        places += [(each.light, found.lights[each.name]) for each in self.passes]
        axes = tuple(1 + axis for axis in FLIPS[self.layout.radiance.flip])
        replaced = []
        for channels, image in places:
            header, names = find_channels(source, channels)
            planes = dict(zip(names, np.flip(image[0].numpy(), axes), strict=True))
            replaced.append(NewPixels(header, planes, self.sequence.window))
        try:
            replace_channels(source, target, *replaced)
        except ExrHeaderError as error:
            raise SourceError(f"{source}: {error}") from error
        return target


def find_noisy_sequences(
    source: Path | str,
    layout: str = "",
    *,
    others: Mapping[str, Path | str] | None = None,
    spp: float | None = None,
    frames: tuple[int, int] | None = None,
    warm_up: int = WARM_UP,
    layer: str = "",
    needs_motion: bool = True,
    has_memory: bool = True,
    is_static: bool = False,
    passes: Sequence[str] = (),
) -> list[NoisySequence]:
    """The shots in a folder, or that of loose images (`loose.py`), sorted by name.

    Loose are a single file, a pattern of files, and what `others` name, by albedo, normal, depth
    or motion. Of a piece `frames` of a shot, a method with a memory also reads up to `warm_up`
    frames before it; without a memory, frames may have gaps. `passes` are denoised beside the image
    (`passes.py`). Without `needs_motion`, and where nothing moves, no motion is
    read.

    Raises SourceError for files without a mean image in this layout, for several images of one
    frame, for a layout whose radiance is not that of the file, GapError for frames between others
    that are missing, and NoMotionError for motion that is needed and missing.
    """
    if layout in FORMATS:
        raise SourceError(f"layout '{layout}' holds samples in archives; denoise takes EXR files")
    given = read_layout(layout) if layout else None
    if given:
        _check_replaceable(given, layout)
        given = replace(given, layer=layer or given.layer)
    source = Path(source)
    if source.is_dir() and not others and (given or _holds_blender(source, layer)):
        folder, read = source, given or replace(read_layout("blender"), layer=layer)
        means, spp = _as_means(read, source, spp)
        clips: Clips = match_files(source, means)
        if not any(
            "radiance" in images for numbered in clips.values() for images in numbered.values()
        ):
            raise _no_radiance(source, layout or "blender", means)
    else:
        radiance = parse_loose_image(source)
        images = {name: parse_loose_image(path) for name, path in (others or {}).items()}
        folder = radiance.folder
        read, clips = match_loose_images(radiance, images, given, layer)
        means, _ = _as_means(read, folder, None)
        needs_motion = needs_motion and not radiance.is_single
    has_motion = needs_motion and not is_static
    means = replace(means, motion=means.motion if has_motion else None)
    select = partial(
        select_piece, frames=frames, warm_up=warm_up * has_memory, has_gaps=not has_memory
    )
    overviews = build_sequences(folder, clips, means, _select_some)
    shots = []
    for sequence, overview in zip(
        build_sequences(folder, clips, means, select), overviews, strict=True
    ):
        _check_sequence(sequence, has_motion)
        shot = NoisySequence(
            folder,
            add_sky_motion(sequence, means, folder),
            means,
            spp,
            is_static,
            start=sum(number < frames[0] for number in sequence.numbers) if frames else 0,
            overview=overview.radiance,
            frames=frames,
            passes=find_passes(sequence.radiance[0], passes, means.layer),
        )
        _ = shot.primaries  # raises for colours that are not linear
        shots.append(shot)
    return shots


def select_piece(
    label: str,
    numbers: Iterable[int],
    *,
    frames: tuple[int, int] | None,
    warm_up: int,
    has_gaps: bool,
) -> tuple[int, ...]:
    """The frames in a range, or all, and up to `warm_up` before it that have no gap between them.

    Raises SourceError where there is none, GapError where one is missing that must not be.
    """
    existing = sorted(set(numbers))
    first, end = frames or (existing[0], existing[-1] + 1)
    inside = tuple(number for number in existing if first <= number < end)
    if not inside:
        raise SourceError(
            f"{label} has no frame from {first} to {end - 1}; its frames are {existing[0]} to "
            f"{existing[-1]}"
        )
    if has_gaps:
        return inside
    try:
        chosen = select_frames(label, existing, frames)
    except SourceError as error:
        raise GapError(
            f"{error}; or take a row without a memory, which needs no frames between: -m oidn"
        ) from error
    earlier = range(first - 1, first - 1 - warm_up, -1)
    before = takewhile(lambda number: number in existing, earlier)
    return (*reversed(tuple(before)), *chosen)


def _select_some(_: str, numbers: Iterable[int]) -> tuple[int, ...]:
    """Up to 8 frames of those there are, evenly spaced."""
    existing = sorted(set(numbers))
    count = min(len(existing), MAX_EXPOSURE_FRAMES)
    return tuple(existing[round(index)] for index in np.linspace(0, len(existing) - 1, count))


def _holds_blender(folder: Path, layer: str) -> bool:
    """Whether the first EXR file in a folder has the passes of Blender. Raises SourceError."""
    files = (path for path in limits.list_files(folder) if path.suffix.lower() == ".exr")
    first = next(files, None)
    return first is not None and is_blender(first, layer)


def _no_radiance(folder: Path, layout: str, means: Layout) -> SourceError:
    names = ", ".join(sorted(path.name for path in folder.iterdir())[:8]) or "nothing"
    return SourceError(
        f"{folder} holds no image of layout '{layout}': expected "
        f"{' or '.join(means.radiance.patterns)}; it holds: {names}. rlbench lint --guess "
        f"{folder} writes a layout"
    )


def _as_means(layout: Layout, folder: Path, spp: float | None) -> tuple[Layout, float | None]:
    """The layout with means for samples and for the reference, and the spp of file names.

    Raises SourceError where names have several spp and none of them was chosen.
    """
    if any("{spp}" in pattern for pattern in layout.radiance.patterns):
        files = match_files(folder, replace(layout, reference=_reference(layout)))
        numbered = (images["radiance"] for frames in files.values() for images in frames.values())
        counts = sorted({key.spp for found in numbered for key in found})
        if spp not in counts and (spp or len(counts) > 1):
            given = f"--spp {spp:g}" if spp else "no --spp"
            raise SourceError(f"{folder} has images of {counts} spp, and {given} was given")
        spp = spp or next((float(count) for count in counts), None)
        tables: Mapping[str, Any] = {
            name: replace(image, files=_with_spp(image.patterns, round(spp or 1)))
            for name, image in layout.images.items()
        }
        layout = replace(layout, **tables)
    radiance = replace(layout.radiance, samples="separate")
    layout = replace(layout, radiance=radiance, reference=_reference(layout))
    # the image goes back into the same file, all of it where no buffer depends on its width
    overscan: Any = "cut" if layout.depth and layout.depth.kind == "distance" else "keep"
    return replace(layout, chromaticities="keep", overscan=overscan), spp


def _reference(layout: Layout) -> Reference:
    """The radiance in place of a reference, which no frame has."""
    mean = layout.radiance
    return Reference(files=mean.files, channels=mean.channels, part=mean.part, flip=mean.flip)


def _with_spp(patterns: tuple[str, ...], spp: int) -> tuple[str, ...]:
    return tuple(p.replace("{spp}", str(spp).zfill(width)) for p in patterns for width in WIDTHS)


def _check_replaceable(layout: Layout, name: str) -> None:
    """Raise SourceError where the method's radiance is not what the file's channels hold."""
    radiance = layout.radiance
    reasons = {
        "radiance that is divided by albedo": radiance.demodulated,
        "radiance in sRGB": radiance.encoding != "linear",
        "straight alpha": radiance.alpha != "premultiplied",
        "specular light of its own": layout.specular,
        "emission of its own": layout.emission,
    }
    if found := [reason for reason, applies in reasons.items() if applies]:
        raise SourceError(
            f"layout '{name}' has {' and '.join(found)}, so the denoised image cannot take the "
            "place of its channels; give a layout whose [radiance] is the whole linear image"
        )


def _check_sequence(sequence: ImportedSequence, has_motion: bool) -> None:
    """Raise SourceError for several images of one frame, NoMotionError for missing motion."""
    number, count = max(
        zip(sequence.numbers, sequence.counts, strict=True), key=lambda each: each[1]
    )
    if count > 1:
        raise SourceError(
            f"clip '{sequence.name}', frame {number} has {count} images of radiance, expected one "
            "mean; average them first, or make a clip of samples: rlbench import"
        )
    if has_motion and NO_MOTION in sequence.limitations and len(sequence.numbers) > 1:
        notes = "; ".join(note for note in sequence.notes if "[motion]" in note)
        raise NoMotionError(
            f"clip '{sequence.name}' has no motion vectors{notes and ': ' + notes}. Render them "
            "(Blender: the pass Vector, without motion blur), name their files with --motion, set "
            'missing_motion = "flow" in a layout, say with --static that nothing moves, or take a '
            "row without a memory: -m oidn"
        )
