"""A folder of EXR files in any layout: which files belong to which image of which frame."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from rlbench.apps.dumps.importers import limits
from rlbench.apps.dumps.importers.dump_frame import (
    FrameFiles,
    count_samples,
    find_overscan,
    has_image,
    image_size,
    read_frame,
)
from rlbench.apps.dumps.importers.file_pattern import FileKey, SignReader
from rlbench.apps.dumps.importers.jitter import remove_jitter
from rlbench.apps.dumps.importers.layout import Layout
from rlbench.apps.dumps.importers.sequence import (
    ImportedSequence,
    check_complete,
    clip_name,
    select_frames,
)
from rlbench.apps.dumps.importers.stand_ins import add_stand_ins
from rlbench.clips.exr import window_size
from rlbench.errors import SourceError

GBUFFER = ("albedo", "normal", "depth", "motion")
Files = dict[FileKey, tuple[int, Path]]  # with the rank of the pattern that matched
Clips = Mapping[str, Mapping[int, Mapping[str, Files]]]  # by clip, frame and image
Select = Callable[[str, Iterable[int]], tuple[int, ...]]  # frames that are read, of those there are


@dataclass(frozen=True)
class _Selection:
    """The files of the frames of one clip, and what they have in common."""

    frames: Mapping[int, FrameFiles]
    halves: int  # 1 or 2
    absent: tuple[str, ...]  # images that the layout names and no frame has


def find_dump_sequences(
    source: Path, layout: Layout, frames: tuple[int, int] | None = None
) -> list[ImportedSequence]:
    """The sequences in a dump, each of which becomes a clip; empty if no file of radiance matches.

    Raises SourceError for files that contradict the layout or each other.
    """
    select = partial(select_frames, frames=frames)
    return build_sequences(source, match_files(source, layout), layout, select)


def build_sequences(
    source: Path, clips: Clips, layout: Layout, select: Select
) -> list[ImportedSequence]:
    """The sequences of files that were matched, with the frames that `select` chooses.

    `select` gets a label for messages and the frames that have radiance. Raises SourceError for
    files that contradict the layout or each other.
    """
    return [
        _sequence(source, clip, numbered, layout, select)
        for clip, numbered in sorted(clips.items())
        if any("radiance" in files for files in numbered.values())
    ]


def match_files(source: Path, layout: Layout) -> dict[str, dict[int, dict[str, Files]]]:
    """The files that match the layout: by clip, frame and image; `source` may be a single file.

    Raises SourceError.
    """
    clips: dict[str, dict[int, dict[str, Files]]] = defaultdict(
        lambda: defaultdict(lambda: defaultdict(dict))
    )
    if source.is_file():
        paths = {source: Path(source.name)}
    else:
        paths = {path: path.relative_to(source) for path in limits.list_files(source)}
    patterns = [pattern for image in layout.images.values() for pattern in image.patterns]
    signs = SignReader(paths.values(), patterns)
    for path, relative in paths.items():
        for name, image in layout.images.items():
            for rank, pattern in enumerate(image.patterns):
                if key := signs.match(pattern, relative):
                    files = clips[key.clip][key.frame][name]
                    _add(files, key._replace(clip=""), rank, path)
                    break
    return clips


def _add(files: Files, key: FileKey, rank: int, path: Path) -> None:
    """Add a file, unless one of a preferred pattern is there. Raises SourceError for two alike."""
    best = min((other for other, _ in files.values()), default=rank)
    if rank > best:
        return
    if rank < best:
        files.clear()
    if key in files:
        raise SourceError(f"{path} and {files[key][1].name} are the same image of one frame")
    files[key] = (rank, path)


def sequence_name(source: Path, clip: str) -> str:
    """The name of a sequence: the words of what {clip} stands for, or the folder's."""
    words = [part for word in clip.split("/") if (part := word.strip("_-. "))]
    return clip_name("-".join(words) or source.resolve().name)


def _sequence(
    source: Path,
    clip: str,
    numbered: Mapping[int, Mapping[str, Files]],
    layout: Layout,
    select: Select,
) -> ImportedSequence:
    name = sequence_name(source, clip)
    rendered = [number for number, files in numbered.items() if "radiance" in files]
    numbers = select(f"clip '{name}'", rendered)
    found = _select(name, {number: numbered[number] for number in numbers}, layout)
    size = image_size(found.frames[numbers[0]], "radiance", layout)
    window = None if layout.overscan == "cut" else find_overscan(found.frames.values(), layout)
    shape = window_size(window) if window else size
    available = {n: _choose(numbered[n], layout) for n in rendered} if layout.moves_onward else {}
    sequence = ImportedSequence(
        name=name,
        sampler=f"{layout.renderer}, imported",
        height=shape[0],
        width=shape[1],
        numbers=numbers,
        first_number=min(rendered),
        counts=tuple(count_samples(found.frames[n], layout) for n in numbers),
        reference_spp=tuple(_reference_spp(found.frames[n], layout, found.halves) for n in numbers),
        buffers=tuple(b for b in GBUFFER if getattr(layout, b) and b not in found.absent),
        limitations=_limitations(layout, found, numbers[0] - 1 in rendered),
        files=tuple(path for files in found.frames.values() for path in files.paths),
        frame_files=tuple(tuple(found.frames[n].paths) for n in numbers),
        read=partial(
            read_frame, {**available, **found.frames}, layout, size, source, min(rendered), window
        ),
        window=window,
        fps=layout.frames_per_second,
        exposure=None if layout.exposure == "auto" else float(layout.exposure),
        convention=repr(layout),
        notes=tuple(_absence(layout, image) for image in found.absent),
    )
    return remove_jitter(add_stand_ins(sequence, layout.missing_motion), layout, source)


def _select(name: str, numbered: Mapping[int, Mapping[str, Files]], layout: Layout) -> _Selection:
    """The files of the frames of a clip. Raises SourceError where frames have different ones."""
    frames = {number: _choose(files, layout) for number, files in numbered.items()}
    absent = []
    for image in layout.images:
        having = [number for number, files in frames.items() if files.images.get(image)]
        if image == "radiance" or (image == "reference" and not layout.reference.optional):
            _require(name, image, having, frames, layout, numbered)
        elif image == "reference":
            continue
        elif not having or not has_image(frames[having[0]], image, layout):
            absent.append(image)
            _check_absent(name, image, having[1:], frames, layout)
        elif len(having) < len(frames):
            check_complete(f"clip '{name}', {image}", frames, having)
    halves = min(
        (count for f in frames.values() if (count := len(f.images["reference"]))), default=1
    )
    halves = min(2, halves)
    read = {n: files.without(absent).with_references(halves) for n, files in frames.items()}
    return _Selection(read, halves, tuple(absent))


def _check_absent(
    name: str, image: str, others: Iterable[int], frames: Mapping[int, FrameFiles], layout: Layout
) -> None:
    """Raise SourceError where another frame has the channels that the first lacks."""
    for number in others:
        if has_image(frames[number], image, layout):
            raise SourceError(
                f"clip '{name}': frame {number} has the channels of [{image}], frame {min(frames)} "
                "has not; render it again, or select others with --frames FIRST:END"
            )


def _require(
    name: str,
    image: str,
    having: Iterable[int],
    frames: Mapping[int, FrameFiles],
    layout: Layout,
    numbered: Mapping[int, Mapping[str, Files]],
) -> None:
    """Raise SourceError for the first frame without 1-spp images, or without a reference."""
    for number in sorted(set(frames) - set(having)):
        content = sorted(p.name for files in numbered[number].values() for _, p in files.values())
        patterns = " or ".join(layout.images[image].patterns)
        reason = {
            "radiance": "no image of 1 spp, and a mean of more cannot be separated into the "
            "samples that methods draw (rlbench denoise takes it as it is)",
            "reference": "no reference, so nothing can be scored on it (if that is meant, set "
            "optional = true in [reference] of a layout)",
        }[image]
        raise SourceError(
            f"clip '{name}', frame {number} has {reason}: expected {patterns}; "
            f"it has: {', '.join(content)}"
        )


def _choose(files: Mapping[str, Files], layout: Layout) -> FrameFiles:
    """The files that are read: samples in order, references of the most spp, one of each buffer."""
    by_image = {
        name: {key: path for key, (_, path) in found.items()} for name, found in files.items()
    }
    radiance = by_image.get("radiance", {})
    if layout.radiance.samples == "accumulated":
        keys = sorted(radiance, key=lambda key: key.spp)
        run = [key for count, key in enumerate(keys, 1) if key.spp == count]
    else:
        run = sorted(key for key in radiance if key.spp <= 1)
    images = {"radiance": [radiance[key] for key in run]}
    for name in ("specular",):
        images[name] = [by_image[name][key] for key in run if key in by_image.get(name, {})]
    references = by_image.get("reference", {})
    most = max((key.spp for key in references), default=0)
    best = sorted(key for key in references if key.spp == most and most != 1)
    images["reference"] = [references[key] for key in best]
    for name in (*GBUFFER, "emission"):
        found = by_image.get(name, {})
        first = run[0] if run and run[0] in found else min(found, default=None)
        images[name] = [found[first]] if first is not None and first.spp <= 1 else []
    return FrameFiles(images, most)


def _reference_spp(files: FrameFiles, layout: Layout, halves: int) -> int:
    return layout.reference.spp or halves * files.reference_spp


def _limitations(layout: Layout, found: _Selection, has_previous: bool) -> tuple[str, ...]:
    limitations = [] if found.halves == 2 else ["halves"]
    if not all(files.images["reference"] for files in found.frames.values()):
        limitations.append("no reference")
    if "srgb" in (layout.radiance.encoding, layout.reference.encoding):
        limitations.append("linear")
    normal = layout.normal
    has_space = normal and (normal.space == "world" or (normal.space == "view" and normal.camera))
    if normal and "normal" not in found.absent and not has_space:
        limitations.append("normal")
    if layout.moves_onward and "motion" not in found.absent and not has_previous:
        limitations.append("first motion")
    return tuple(limitations)


def _absence(layout: Layout, image: str) -> str:
    patterns = " or ".join(layout.images[image].patterns)
    return f"no file has the channels of [{image}] and matches {patterns}"
