"""Writing a sequence down as a clip: frame by frame, resumable, and finished with its header."""

from __future__ import annotations

from collections.abc import Callable
from hashlib import sha256
from pathlib import Path

from rlbench.clips.compatibility import compatibility_summary
from rlbench.clips.frame_files import file_kinds
from rlbench.clips.header import FILE
from rlbench.clips.importers import limits
from rlbench.clips.importers.sequence import ImportedSequence, SourceError
from rlbench.clips.stored import Header, has_frame, write_frame, write_header
from rlbench.system import paths

MARK = "source.txt"  # beside the frames: what they were imported from


def clip_header(sequence: ImportedSequence, samples: int | None, exposure: float = 1.0) -> Header:
    """The header of the clip that a sequence becomes, with `samples` of each pixel, or all.

    Raises SourceError where a frame has fewer, or all are wanted and frames differ.
    """
    least = min(sequence.counts)
    poor = sequence.numbers[sequence.counts.index(least)]
    if samples is None and least != max(sequence.counts):
        raise SourceError(
            f"clip '{sequence.name}': frame {poor} has {_images(least)} of 1 spp, others up to "
            f"{max(sequence.counts)}; take as many of each with --samples {least}"
        )
    wanted = samples or min(least, limits.MOST_SAMPLES)
    header = Header(
        name=sequence.name,
        scene=f"imported-{sequence.name}",  # no scene of ours, whose costs it would be charged
        sampler=sequence.sampler,
        height=sequence.height,
        width=sequence.width,
        frames=len(sequence.numbers),
        fps=sequence.fps,
        exposure=exposure,
        pool_spp=min(wanted, least),
        reference_spp=sequence.reference_spp,
        buffers=sequence.buffers,
        lacks=sequence.lacks,
    )
    if wanted > least:
        raise SourceError(
            f"clip '{sequence.name}': {wanted} samples of each pixel are wanted, frame {poor} has "
            f"{_images(least)} of 1 spp. With --samples {least} {compatibility_summary(header)}"
        )
    return header


def store(
    sequence: ImportedSequence,
    header: Header,
    folder: Path,
    tell: Callable[[], None] = lambda: None,
) -> None:
    """Write what `folder` lacks of the clip, the header last; `tell` hears of each frame.

    Killed at any moment and called again, it leaves the same files. Raises SourceError where the
    folder holds frames of another import or of a renderer, before anything is changed.
    """
    _claim(sequence, header, folder)
    for index, number in enumerate(sequence.numbers):
        if not has_frame(folder, index, header.pools):
            still = sequence.read(number, header.pool_spp)
            write_frame(
                folder, index, still.gbuffer, {"path": still.pool}, still.half_a, still.half_b
            )
        tell()
    write_header(folder, header)


def finished(sequence: ImportedSequence, header: Header, folder: Path) -> bool:
    """Is there a clip.toml, and every frame, of this very source?"""
    whole = all(has_frame(folder, index, header.pools) for index in range(header.frames))
    return whole and (folder / FILE).is_file() and _marked(folder) == _mark(sequence, header)


def _claim(sequence: ImportedSequence, header: Header, folder: Path) -> None:
    mark = _mark(sequence, header)
    if _marked(folder) == mark:
        return
    if _marked(folder) or any(folder.glob("*.exr")) or (folder / FILE).exists():
        raise SourceError(
            f"{folder} holds a clip from elsewhere, or from these files before they changed; "
            "move it away, or import into another --out"
        )
    with paths.replacing(folder / MARK) as path:
        path.write_text(mark)


def _mark(sequence: ImportedSequence, header: Header) -> str:
    """What frames are made of: names, sizes and times of all files, and what is taken of them."""
    stamps = [(path.name, path.stat().st_size, path.stat().st_mtime_ns) for path in sequence.files]
    content = (stamps, sequence.numbers, header.pool_spp, header.buffers, file_kinds(header.pools))
    return f"{sequence.sampler}\n{sha256(repr(content).encode()).hexdigest()}\n"


def _marked(folder: Path) -> str:
    mark = folder / MARK
    return mark.read_text() if mark.is_file() else ""


def _images(count: int) -> str:
    return f"{count} image{'s' * (count != 1)}"
