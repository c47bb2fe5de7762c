"""What can be imported: dumps in a layout, ready or the user's, and two formats of their own.

A module per format turns a folder into sequences of frames. It has `find_sequences(source, frames)`
and `LAYOUT`, examples of its file names.
"""

from __future__ import annotations

import importlib
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path, PurePath

from rlbench.apps.dumps.importers import left_out, limits
from rlbench.apps.dumps.importers.dump import find_dump_sequences
from rlbench.apps.dumps.importers.file_pattern import match_pattern
from rlbench.apps.dumps.importers.layout import read_layout, ready_layouts
from rlbench.apps.dumps.importers.sequence import ImportedSequence
from rlbench.apps.dumps.importers.sky import add_sky_motion
from rlbench.apps.dumps.importers.stand_ins import add_stand_ins
from rlbench.clips.header import FILE
from rlbench.errors import SourceError

FORMATS = {  # what no layout describes: zarr arrays in zips; 8-bit PNG with motion as torch tensors
    "noisebase": "rlbench.apps.dumps.importers.noisebase",
    "rl-path-tracing": "rlbench.apps.dumps.importers.rl_path_tracing",
}
ALIASES = {"paper": "rl-path-tracing"}  # other accepted names


def find_sequences(
    source: Path, layout: str, frames: tuple[int, int] | None = None, layer: str = ""
) -> list[ImportedSequence]:
    """The sequences in a folder, sorted by name; each becomes one clip.

    `layout` is the name of a ready layout or of a format, or a TOML file. `frames` selects the
    frames from its first number to its second, exclusive. `layer` is the layout's. Buffers that the
    source lacks are replaced by stand-ins.

    Raises SourceError for an unknown layout, for a folder without a sequence, for two sequences of
    one name, and for files that cannot be imported.
    """
    layout = ALIASES.get(layout, layout)
    if layout in FORMATS:
        module = importlib.import_module(FORMATS[layout])
        found = _check(module.find_sequences(source, frames))
        clips = [add_stand_ins(clip) for clip in found]
        expected = module.LAYOUT
    else:
        read = read_layout(layout, [*ready_layouts(), *FORMATS])
        read = replace(read, layer=layer or read.layer)
        found = _check(find_dump_sequences(source, read, frames))
        clips = [add_sky_motion(clip, read, source) for clip in found]
        expected = " or ".join(read.radiance.patterns)
    if not clips:
        if (source / FILE).is_file():
            raise SourceError(f"{source} is a clip already: rlbench lint {source} checks it")
        near = _find_near(source, layout)
        hint = f" Did you mean rlbench import {near}?" if near else ""
        content = ", ".join(sorted(path.name for path in source.iterdir())[:8]) or "nothing"
        raise SourceError(
            f"{source} holds nothing of layout '{layout}': expected files such as {expected}; it "
            f"holds: {content}.{hint} rlbench lint --guess {source} writes a layout"
        )
    counts = Counter(sequence.name for sequence in clips)
    if duplicates := [name for name, count in counts.items() if count > 1]:
        raise SourceError(
            f"{source} holds two clips named '{duplicates[0]}'; import their folders separately"
        )
    return sorted(clips, key=lambda sequence: sequence.name)


def _check(clips: list[ImportedSequence]) -> list[ImportedSequence]:
    """The same clips. Raises SourceError for one that is too large, before a pixel is read."""
    for clip in clips:
        limits.check_clip(clip.name, clip.files, clip.height, clip.width)
    return clips


def _find_near(source: Path, layout: str) -> Path | None:
    """A folder directly above or below, from which files of radiance match a layout."""
    if layout in FORMATS:
        return None
    patterns = read_layout(layout).radiance.patterns
    for path in limits.list_files(source):
        folder, *rest = path.relative_to(source).parts
        above = PurePath(source.resolve().name, folder, *rest)
        for pattern in patterns:
            if rest and match_pattern(pattern, PurePath(*rest)):
                return source / folder
            if match_pattern(pattern, above):
                return source.resolve().parent
    return None


def describe_left_out(
    source: Path,
    layout: str,
    drawn: Sequence[tuple[ImportedSequence, int]],
    frames: tuple[int, int] | None = None,
) -> list[str]:
    """Lines that name the files of a source which no clip is made from, with the reasons.

    `drawn` are the sequences that `find_sequences` found, with the samples per pixel of each clip.
    """
    read = None if ALIASES.get(layout, layout) in FORMATS else read_layout(layout)
    files = left_out.find_left_out(source, read, drawn, frames)
    files.pop(Path(layout), None)  # a layout that lies in the dump itself
    return list(left_out.describe_left_out(source, files))
