"""Formats that can be imported. A module per format turns a folder into sequences of frames."""

from __future__ import annotations

import importlib
from collections import Counter
from pathlib import Path

from rlbench.clips.importers.sequence import ImportedSequence, SourceError

__all__ = ["FORMATS", "find_sequences"]

FORMATS = {
    "oidn": "rlbench.clips.importers.oidn",
    "noisebase": "rlbench.clips.importers.noisebase",
    "rl-path-tracing": "rlbench.clips.importers.rl_path_tracing",
}
ALIASES = {"paper": "rl-path-tracing"}  # old names, still accepted


def find_sequences(
    source: Path, format_: str, frames: tuple[int, int] | None = None
) -> list[ImportedSequence]:
    """The sequences in a folder, sorted by name; each becomes one clip.

    `frames` selects the frames from its first number to its second, exclusive. A format's module
    has `find_sequences(source, frames)` and `LAYOUT`, examples of its file names.

    Raises SourceError for an unknown format, for a folder without a sequence, for two sequences of
    one name, and for files that cannot be imported.
    """
    format_ = ALIASES.get(format_, format_)
    if format_ not in FORMATS:
        raise SourceError(f"no format '{format_}'; there are: {', '.join(FORMATS)}")
    module = importlib.import_module(FORMATS[format_])
    clips: list[ImportedSequence] = module.find_sequences(source, frames)
    if not clips:
        content = ", ".join(sorted(path.name for path in source.iterdir())[:8]) or "nothing"
        raise SourceError(
            f"{source} holds nothing of format '{format_}': expected files such as "
            f"{module.LAYOUT}; it holds: {content}"
        )
    counts = Counter(sequence.name for sequence in clips)
    if duplicates := [name for name, count in counts.items() if count > 1]:
        raise SourceError(
            f"{source} holds two clips named '{duplicates[0]}'; import their folders separately"
        )
    return sorted(clips, key=lambda sequence: sequence.name)
