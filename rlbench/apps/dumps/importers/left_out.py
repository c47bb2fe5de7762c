"""What an import leaves out: every file of a source is read, or listed here with the reason."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from rlbench.apps.dumps.importers import limits
from rlbench.apps.dumps.importers.dump import sequence_name
from rlbench.apps.dumps.importers.file_pattern import FileKey, SignReader
from rlbench.apps.dumps.importers.layout import Image, Layout, Radiance
from rlbench.apps.dumps.importers.sequence import ImportedSequence


def find_left_out(
    source: Path,
    layout: Layout | None,
    drawn: Sequence[tuple[ImportedSequence, int]],
    frames: tuple[int, int] | None = None,
) -> dict[Path, str]:
    """The files below a source that no clip is made from, each with the reason.

    `layout` is None for a format that has none. `drawn` are the sequences that are imported, with
    the samples per pixel that are read of each; `frames` is the range that was asked for.
    """
    clips = {sequence.name: (sequence, samples) for sequence, samples in drawn}
    used = {path for sequence, _ in drawn for path in sequence.files}
    if layout:
        used |= {source / name for name in layout.other_files}
    entries = limits.list_entries(source)
    matched = _match(source, layout, entries) if layout else {}
    spare = dict(_spare_samples(source, matched, clips))
    left_out = {path: "not a file" for path in entries if not path.is_file()}
    for path in entries:
        if path.is_symlink() and path.is_dir():
            left_out[path] = "a link to a folder, which is not entered"
        elif path in spare:
            left_out[path] = spare[path]
        elif path not in used and path not in left_out:
            left_out[path] = _reason(source, matched.get(path), clips, layout, frames)
    return dict(sorted(left_out.items()))


def describe_left_out(source: Path, left_out: Mapping[Path, str]) -> Iterator[str]:
    """Lines that name all files that are left out, numbered ones as a run, and the sum at the end.

    >>> files = {Path("dump", f"b.{i}.exr"): "no radiance" for i in (7, 8, 9)}
    >>> list(describe_left_out(Path("dump"), files))
    ['  left out, no radiance: b.7.exr to b.9.exr (3 files)', '3 files of dump are left out']
    """
    runs: dict[tuple[str, str], list[str]] = defaultdict(list)
    for path, reason in left_out.items():
        name = path.relative_to(source).as_posix()
        runs[reason, re.sub(r"\d+", "#", name)].append(name)
    for (reason, _), names in runs.items():
        names.sort(key=lambda name: [int(number) for number in re.findall(r"\d+", name)])
        run = f"{names[0]} to {names[-1]} ({len(names)} files)" if len(names) > 1 else names[0]
        yield f"  left out, {reason}: {run}"
    if left_out:
        plural = "s" if len(left_out) > 1 else ""
        yield f"{len(left_out)} file{plural} of {source} {'are' if plural else 'is'} left out"


Match = tuple[str, Image, FileKey]  # name of a table, its image, and what the file's name says


def _match(source: Path, layout: Layout, paths: Sequence[Path]) -> dict[Path, Match]:
    """The first image of the layout that each path belongs to: radiance, reference, buffers."""
    relative = {path: path.relative_to(source) for path in paths}
    patterns = [pattern for image in layout.images.values() for pattern in image.patterns]
    signs, found = SignReader(relative.values(), patterns), {}
    for path, below in relative.items():
        keys = (
            (name, image, signs.match(pattern, below))
            for name, image in layout.images.items()
            for pattern in image.patterns
        )
        if match := next(((n, image, key) for n, image, key in keys if key), None):
            found[path] = match
    return found


def _spare_samples(
    source: Path,
    matched: Mapping[Path, Match],
    clips: Mapping[str, tuple[ImportedSequence, int]],
) -> Iterator[tuple[Path, str]]:
    """The images of 1 spp beyond those that are read of each frame."""
    runs: dict[tuple[str, str, int], list[tuple[FileKey, Path]]] = defaultdict(list)
    for path, (table, _, key) in matched.items():
        name = sequence_name(source, key.clip)
        in_clip = name in clips and path in clips[name][0].files
        if table in ("radiance", "specular") and in_clip:
            runs[name, table, key.frame].append((key, path))
    for (name, *_), files in runs.items():
        samples = clips[name][1]
        for _, path in sorted(files)[samples:]:
            yield path, f"not among the first {samples} samples of its pixel"


def _reason(
    source: Path,
    match: Match | None,
    clips: Mapping[str, tuple[ImportedSequence, int]],
    layout: Layout | None,
    frames: tuple[int, int] | None,
) -> str:
    """Why a file is in no clip."""
    if match is None:
        return "no pattern of the layout matches" if layout else "not of this format"
    name, image, key = match
    clip, _ = clips.get(sequence_name(source, key.clip), (None, 0))
    if clip is None:
        return f"[{name}] of a clip without an image of 1 spp"
    if key.frame not in clip.numbers:
        is_outside = frames and not frames[0] <= key.frame < frames[1]
        return "not in --frames" if is_outside else f"[{name}] of a frame without [radiance]"
    if isinstance(image, Radiance):
        if image.samples == "accumulated":
            return f"[{name}], a mean of {key.spp} samples where one of fewer is missing"
        return f"[{name}], a mean of {key.spp} samples, which cannot be separated"
    if name == "reference":
        return "[reference], of which two are read of each frame, those with the most samples"
    return f"[{name}], of which one is read of each frame, that of the first sample"
