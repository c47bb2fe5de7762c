"""The formats that can be imported; each is a module that turns a folder into sequences."""

from __future__ import annotations

import importlib
from collections import Counter
from pathlib import Path

from rlbench.clips.importers.sequence import ImportedSequence, SourceError

FORMATS = {
    "oidn": "rlbench.clips.importers.oidn",
    "noisebase": "rlbench.clips.importers.noisebase",
    "paper": "rlbench.clips.importers.rl_path_tracing",
}


def sequences(
    source: Path, format_: str, wanted: tuple[int, int] | None = None
) -> list[ImportedSequence]:
    """What a folder holds in a format: one sequence a clip, by name; `wanted` frames of each.

    A format's module has `sequences(source, wanted)` and `LAYOUT`, the names of its files. Raises
    SourceError for an unknown format, where nothing is found, and where something is amiss.
    """
    if format_ not in FORMATS:
        raise SourceError(f"no format '{format_}'; there are: {', '.join(FORMATS)}")
    module = importlib.import_module(FORMATS[format_])
    found: list[ImportedSequence] = module.sequences(source, wanted)
    if not found:
        have = ", ".join(sorted(path.name for path in source.iterdir())[:8]) or "nothing"
        raise SourceError(
            f"{source} holds nothing of format '{format_}': expected files such as "
            f"{module.LAYOUT}; it holds: {have}"
        )
    names = Counter(sequence.name for sequence in found)
    if twice := [name for name, count in names.items() if count > 1]:
        raise SourceError(f"{source} holds two clips named '{twice[0]}'; import each by itself")
    return sorted(found, key=lambda sequence: sequence.name)
