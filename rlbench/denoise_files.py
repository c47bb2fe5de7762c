"""Denoise the frames of a folder: mean images in, copies of their files out, in order, resumable.

Layouts are those of `rlbench import`. Here the radiance of a layout is the mean of any number of
samples, there is no reference, and the denoised radiance takes the place of the mean's channels in
a copy of its file. Beside the copies, NAME.denoise.json says how they were made. A method's state
is written every 8 frames; a killed command begins at the last state, and without a state from the
first frame, so that its images are those of a command that was not killed.
"""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file

from rlbench.clips.exr import ExrHeaderError
from rlbench.clips.exr_attributes import read_strings
from rlbench.clips.exr_copy import replace_channels
from rlbench.clips.importers.dump import find_dump_sequences, match_files
from rlbench.clips.importers.dump_frame import FLIPS, image_channels
from rlbench.clips.importers.formats import FORMATS
from rlbench.clips.importers.image_files import find_channels, read_exr_image
from rlbench.clips.importers.layout import Layout, Reference, read_layout
from rlbench.clips.importers.sequence import ImportedSequence, Pixels, SourceError
from rlbench.clips.importers.sky import add_sky_motion
from rlbench.clips.importers.writer import MAX_EXPOSURE_FRAMES
from rlbench.clips.primaries import Chromaticities, format_chromaticities
from rlbench.denoise import (
    DenoiseError,
    NoisyFrame,
    denoise_frame,
    estimate_exposure,
    read_leaves,
    replace_leaves,
)
from rlbench.frames import GBuffer
from rlbench.method import Method, State
from rlbench.system.documents import read_json
from rlbench.system.folder_lock import locked_folder
from rlbench.system.paths import atomic_write

__all__ = ["DenoisingSummary", "NoisySequence", "denoise_sequence", "find_noisy_sequences"]

STATE_PERIOD = 8  # frames between two states on the disk
SAMPLES_ATTRIBUTE = re.compile(r"cycles\..*\.samples")  # by Blender, for each view layer
NO_MOTION = "no motion"  # the limitation of a sequence with motion of 0 in place of its own
WIDTHS = range(1, 7)  # digits of samples per pixel in a file name


@dataclass(frozen=True)
class NoisySequence:
    """The frames of one shot, read one by one."""

    source: Path
    sequence: ImportedSequence
    layout: Layout
    spp: float | None  # samples per pixel of every frame; None: as the files say
    is_static: bool = False  # nothing moves, whatever the files say

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
        buffers = {name: _to_tensor(pixels) for name, pixels in frame.gbuffer.items()}
        is_static = self.is_static or NO_MOTION in self.sequence.limitations
        return NoisyFrame(
            GBuffer(buffers, static=is_static), _to_tensor(frame.pool[0]), self.read_spp(index)
        )

    def read_spp(self, index: int) -> float:
        """Samples per pixel of a frame. Raises SourceError where its file does not say them."""
        if self.spp:
            return self.spp
        path = self.sequence.radiance[index]
        for name, value in read_strings(path):
            if SAMPLES_ATTRIBUTE.fullmatch(name) and value.isdecimal():
                return max(1.0, float(value))
        raise SourceError(f"{path} does not say how many samples a pixel has; give --spp N")

    def estimate_exposure(self) -> float:
        """The exposure for the means of up to 8 frames. Raises SourceError."""
        count = min(len(self), MAX_EXPOSURE_FRAMES)
        files = [self.sequence.radiance[round(i)] for i in np.linspace(0, len(self) - 1, count)]
        channels = image_channels("radiance", self.layout)
        return estimate_exposure(_to_tensor(read_exr_image(f, channels).pixels)[0] for f in files)

    def write(self, index: int, out: Path, image: torch.Tensor) -> Path:
        """Write a copy of a frame's file with this image [1 3 h w] in place of the mean."""
        source, target = self.sequence.radiance[index], self.output(index, out)
        header, names = find_channels(source, image_channels("radiance", self.layout))
        pixels = np.flip(image[0].movedim(0, -1).numpy(), FLIPS[self.layout.radiance.flip])
        planes = dict(zip(names, np.moveaxis(pixels, -1, 0), strict=True))
        try:
            replace_channels(source, target, header, planes)
        except ExrHeaderError as error:
            raise SourceError(f"{source}: {error}") from error
        return target


def find_noisy_sequences(
    source: Path,
    layout: str,
    *,
    spp: float | None = None,
    frames: tuple[int, int] | None = None,
    layer: str = "",
    needs_motion: bool = True,
    is_static: bool = False,
) -> list[NoisySequence]:
    """The shots in a folder, or the one of a single file, sorted by name.

    Without `needs_motion`, and where nothing moves, no motion is read. Raises SourceError for a
    folder without a mean image in this layout, for several images of one frame, for a layout whose
    radiance is not that of the file, and for motion that is needed and missing.
    """
    if layout in FORMATS:
        raise SourceError(f"layout '{layout}' holds samples in archives; denoise takes EXR files")
    read = read_layout(layout)
    _check_replaceable(read, layout)
    folder = source if source.is_dir() else source.parent
    has_motion = needs_motion and not is_static and source.is_dir()
    read = replace(read, layer=layer or read.layer, motion=read.motion if has_motion else None)
    read = read if source.is_dir() else _only_file(read, source)
    means, spp = _as_means(read, source, spp)
    found = [
        add_sky_motion(each, means, folder) for each in find_dump_sequences(source, means, frames)
    ]
    if not found:
        names = ", ".join(sorted(path.name for path in folder.iterdir())[:8]) or "nothing"
        raise SourceError(
            f"{source} holds no image of layout '{layout}': expected "
            f"{' or '.join(means.radiance.patterns)}; it holds: {names}. rlbench lint --guess "
            f"{folder} writes a layout"
        )
    for sequence in found:
        _check_sequence(sequence, has_motion)
    shots = [NoisySequence(folder, each, means, spp, is_static) for each in found]
    for shot in shots:
        _ = shot.primaries  # raises for colours that are not linear
    return shots


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
    return replace(layout, chromaticities="keep"), spp  # the image goes back into the same file


def _reference(layout: Layout) -> Reference:
    """The radiance in place of a reference, which no frame has."""
    mean = layout.radiance
    return Reference(files=mean.files, channels=mean.channels, part=mean.part, flip=mean.flip)


def _with_spp(patterns: tuple[str, ...], spp: int) -> tuple[str, ...]:
    return tuple(p.replace("{spp}", str(spp).zfill(width)) for p in patterns for width in WIDTHS)


def _only_file(layout: Layout, file: Path) -> Layout:
    """The layout of one file, which holds the images that are in the radiance's files."""
    shared: dict[str, Any] = {
        name: replace(image, files=re.sub(r"[\[\]{}*]", "*", file.name))
        for name, image in layout.images.items()
        if set(image.patterns) & set(layout.radiance.patterns)
    }
    none: dict[str, Any] = dict.fromkeys((*layout.images, "camera"))
    return replace(layout, **(none | shared))


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
    """Raise SourceError for several images of one frame, or a sequence without its motion."""
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
        raise SourceError(
            f"clip '{sequence.name}' has no motion vectors{notes and ': ' + notes}. Render them "
            '(Blender: the pass Vector, without motion blur), set missing_motion = "flow" in the '
            "layout, or say with --static that nothing moves"
        )


def _to_tensor(pixels: Pixels) -> torch.Tensor:
    """An image [h w c] as [1 c h w], float32."""
    image = torch.from_numpy(np.ascontiguousarray(pixels, np.float32))
    return image.movedim(-1, 0)[None].contiguous()


@dataclass
class DenoisingSummary:
    """What happened to the frames of one shot."""

    written: int = 0  # frames
    kept: int = 0  # frames that were there
    repairs: Counter[str] = field(default_factory=Counter)  # invalid pixels, by image

    def count(self, repairs: Mapping[str, int]) -> None:
        """Add a written frame."""
        self.written += 1
        self.repairs.update(repairs)


def denoise_sequence(
    noisy: NoisySequence,
    method: Method,
    label: str,
    out: Path,
    *,
    exposure: float | None = None,
    device: torch.device | str = "cpu",
    on_frame: Callable[[], None] = lambda: None,
) -> DenoisingSummary:
    """Write the denoised frames that `out` lacks, or whose source is newer; one frame in memory.

    `label` names the method and its weights. A method with a memory also writes all frames after
    the first that it lacks. Calls `on_frame` once for each frame of the shot.

    Raises DenoiseError where `out` holds frames of other settings, or is the source; SourceError
    for files that cannot be read, FolderInUseError, and WriteError.
    """
    if out.resolve() == noisy.source.resolve():
        raise DenoiseError(f"{out} holds the noisy frames, which are never replaced; give another")
    with locked_folder(out):
        settings = _claim(noisy, label, exposure, out)
        unfinished = [i for i in range(len(noisy)) if not _is_finished(noisy, i, out)]
        state_file = out / f"{noisy.name}.denoise-state.safetensors"
        start, state = len(noisy), None
        if unfinished and method.traits.temporal:
            start, state = _restore(noisy, method, settings, unfinished[0], state_file, device)
            unfinished = list(range(unfinished[0], len(noisy)))
        summary = DenoisingSummary(kept=len(noisy) - len(unfinished))
        for index in range(len(noisy)):
            if index in unfinished or index >= start:
                frame = noisy.read(index)
                result = denoise_frame(method, frame, state, settings["exposure"], device)
                state = result.state
                if index in unfinished:
                    noisy.write(index, out, result.image)
                    summary.count(result.repairs)
                if method.traits.temporal and not (index + 1) % STATE_PERIOD:
                    _save(state, {"next": index + 1, **settings}, state_file)
            on_frame()
        state_file.unlink(missing_ok=True)
        return summary


def _claim(noisy: NoisySequence, label: str, exposure: float | None, out: Path) -> dict[str, Any]:
    """The settings of this shot, written beside its frames. Raises DenoiseError for other ones."""
    file = out / f"{noisy.name}.denoise.json"
    before = read_json(file) if file.is_file() else {}
    settings = {
        "method": label,
        "exposure": exposure or before.get("exposure") or noisy.estimate_exposure(),
        "spp": noisy.spp or "as the files say",
        "static": noisy.is_static,
        "first frame": noisy.sequence.numbers[0],
        "layout": sha256(noisy.sequence.convention.encode()).hexdigest()[:16],
    }
    if changed := [key for key in settings if before and before.get(key) != settings[key]]:
        key = changed[0]
        raise DenoiseError(
            f"{out} holds frames of '{noisy.name}' with the {key} {before.get(key)!r}, now it is "
            f"{settings[key]!r}; write to another --out, or remove {file.name} and the frames"
        )
    with atomic_write(file) as path:
        path.write_text(json.dumps(settings, indent=1) + "\n")
    return settings


def _is_finished(noisy: NoisySequence, index: int, out: Path) -> bool:
    """Whether a frame was written after its source was."""
    target, source = noisy.output(index, out), noisy.sequence.radiance[index]
    return target.is_file() and target.stat().st_mtime_ns >= source.stat().st_mtime_ns


def _save(state: State, settings: Mapping[str, Any], file: Path) -> None:
    """Write a state; one of parts that are unknown is not written."""
    with suppress(TypeError):
        leaves = dict(read_leaves(state))
        tensors = {
            path: leaf.cpu().clone(memory_format=torch.contiguous_format)
            for path, leaf in leaves.items()
            if isinstance(leaf, torch.Tensor)
        }
        numbers = {path: leaf for path, leaf in leaves.items() if path not in tensors}
        words = {"numbers": json.dumps(numbers), "settings": json.dumps(settings)}
        with atomic_write(file) as path:
            save_file(tensors, path, words)


def _restore(
    noisy: NoisySequence,
    method: Method,
    settings: Mapping[str, Any],
    first: int,
    file: Path,
    device: torch.device | str,
) -> tuple[int, State]:
    """The frame to begin with, `first` or one before it, and the state before that frame.

    Without a state of these settings, or where the method's state has another structure now, that
    is the first frame of the shot.
    """
    with suppress(OSError, SafetensorError, LookupError, ValueError):
        with safe_open(file, "pt", str(device)) as stored:
            words = stored.metadata()
            before = json.loads(words["settings"])
            start = before.pop("next")
            if before != settings or not start <= first:
                return 0, None
            leaves = {name: stored.get_tensor(name) for name in stored.keys()}  # noqa: SIM118
        frame = noisy.read(start - 1)
        like = denoise_frame(method, frame, None, settings["exposure"], device).state
        leaves |= json.loads(words["numbers"])
        if all(_is_alike(leaf, leaves.get(path)) for path, leaf in read_leaves(like)):
            return start, replace_leaves(like, leaves)
    return 0, None


def _is_alike(leaf: Any, other: Any) -> bool:
    """Whether one leaf of a state can take the place of another."""
    if not isinstance(leaf, torch.Tensor):
        return type(leaf) is type(other)
    is_tensor = isinstance(other, torch.Tensor)
    return is_tensor and leaf.shape == other.shape and leaf.dtype == other.dtype
