"""Write an imported sequence as a clip: frame by frame, resumable, with its header last."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from hashlib import sha256
from pathlib import Path

import numpy as np

from rlbench.apps.dumps.importers import limits
from rlbench.apps.dumps.importers.repairs import Findings, check_finite, repair_frame
from rlbench.apps.dumps.importers.sequence import ImportedFrame, ImportedSequence
from rlbench.clips.compatibility import compatibility_summary
from rlbench.clips.exposure import area_luminance, exposure_of_frames
from rlbench.clips.frame_files import (
    exceeds_float,
    file_kinds,
    has_frame,
    is_no_reference,
    write_frame,
)
from rlbench.clips.header import FILE, Header, read_header, write_header
from rlbench.clips.image_files import Pixels
from rlbench.errors import SourceError
from rlbench.system import paths, store

MAX_EXPOSURE_FRAMES = 8  # whose references decide the exposure
SOURCE_FILE = "source.txt"  # in the clip folder: what its frames were imported from


def clip_header(sequence: ImportedSequence, samples: int | None, exposure: float = 1.0) -> Header:
    """The header of the clip that a sequence becomes, with `samples` per pixel, or with all.

    Raises SourceError where a frame has fewer samples, or `samples` is None and frames differ.
    """
    fewest = min(sequence.counts)
    frame = sequence.numbers[sequence.counts.index(fewest)]
    if samples is None and fewest != max(sequence.counts):
        raise SourceError(
            f"clip '{sequence.name}': frame {frame} has {_images(fewest)} of 1 spp, others up to "
            f"{max(sequence.counts)}; import as many of each with --samples {fewest}"
        )
    requested = samples or min(fewest, limits.MAX_SAMPLES)
    header = Header(
        name=sequence.name,
        scene=f"imported-{sequence.name}",  # no preset scene: those have a known cost per sample
        sampler=sequence.sampler,
        height=sequence.height,
        width=sequence.width,
        frames=len(sequence.numbers),
        fps=sequence.fps,
        exposure=exposure,
        pool_spp=min(requested, fewest),
        reference_spp=sequence.reference_spp,
        jitter=sequence.jitter,
        buffers=sequence.buffers,
        limitations=sequence.limitations,
    )
    if requested > fewest:
        raise SourceError(
            f"clip '{sequence.name}': {requested} samples per pixel requested, frame {frame} has "
            f"{_images(fewest)} of 1 spp. With --samples {fewest} {compatibility_summary(header)}"
        )
    return header


def estimate_exposure(sequence: ImportedSequence, sanitize: bool = False) -> float:
    """The exposure for the references of up to 8 frames; that of the source, if it has one.

    The rule is that of `rlbench render`, without frames in the dark. Raises SourceError
    for values that are not finite, unless they are to be repaired.
    """
    if sequence.exposure is not None:
        return sequence.exposure
    count = min(len(sequence.numbers), MAX_EXPOSURE_FRAMES)
    chosen = [sequence.numbers[round(i)] for i in np.linspace(0, len(sequence.numbers) - 1, count)]
    frames = (_read_valid(sequence, number, 1, sanitize) for number in chosen)
    return exposure_of_frames(np.stack([area_luminance(_clearest_image(f)) for f in frames]))


def _clearest_image(frame: ImportedFrame) -> Pixels:
    """The reference of a frame, or its sample where there is none."""
    return frame.pool[0] if is_no_reference(frame.half_a) else frame.half_a


def write_clip(
    sequence: ImportedSequence,
    header: Header,
    folder: Path,
    on_frame: Callable[[], None] = lambda: None,
    sanitize: bool = False,
) -> Findings:
    """Write the missing files of a clip, the header last; call `on_frame` after each frame.

    `sanitize` repairs values that are not valid. Returns what was unusual in the frames that were
    written. If it is interrupted and called again, the clip is the same. Raises SourceError for
    values that are not finite, and, before anything is changed, where the folder holds frames of
    another import or of a renderer.
    """
    _claim(sequence, header, folder)
    findings = Findings()
    for index, number in enumerate(sequence.numbers):
        if not has_frame(folder, index, header.pools):
            frame = _read_valid(sequence, number, header.pool_spp, sanitize)
            findings.add(number, frame.counts)
            findings.add(number, {f"broken {k}": int(m.sum()) for k, m in frame.broken.items()})
            _check_exposed(header, number, frame)
            pools = {"path": frame.pool}
            write_frame(folder, index, frame.gbuffer, pools, frame.half_a, frame.half_b)
        on_frame()
    write_header(folder, header)
    return findings


def change_exposure(
    sequence: ImportedSequence, folder: Path, exposure: float, sanitize: bool = False
) -> float:
    """Write another exposure into the header of a finished clip; returns that of before.

    Nothing is written where they are equal. Raises SourceError where exposed radiance would exceed
    float32.
    """
    stored = read_header(folder)
    header = replace(stored, exposure=exposure)
    for number in sequence.numbers if exposure > stored.exposure else ():
        frame = _read_valid(sequence, number, header.pool_spp, sanitize)
        _check_exposed(header, number, frame)
    if exposure != stored.exposure:
        write_header(folder, header)
    return stored.exposure


def is_finished(sequence: ImportedSequence, header: Header, folder: Path) -> bool:
    """Whether the folder holds clip.toml and every frame, imported from this sequence."""
    complete = all(has_frame(folder, index, header.pools) for index in range(header.frames))
    key = _content_key(sequence, header)
    stored_key = store.read_text(folder / SOURCE_FILE)
    return complete and (folder / FILE).is_file() and stored_key == key


def _read_valid(
    sequence: ImportedSequence, number: int, samples: int, sanitize: bool
) -> ImportedFrame:
    """A frame whose values are finite. Raises SourceError where they are not, or repairs them."""
    frame = sequence.read(number, samples)
    is_lost = "reference" in frame.files and is_no_reference(frame.half_a + frame.half_b)
    if sanitize and not is_lost:  # nothing is left of a reference that is NaN everywhere
        return repair_frame(frame)
    check_finite(sequence.name, number, frame)
    return frame


def _check_exposed(header: Header, number: int, frame: ImportedFrame) -> None:
    """Raise SourceError where radiance is not finite once it is exposed: no clip could be read."""
    images = (frame.pool, frame.half_a, frame.half_b)
    if any(exceeds_float(image, header.exposure) for image in images):
        raise SourceError(
            f"clip '{header.name}', frame {number}: radiance times the exposure "
            f"{header.exposure:g} exceeds float32; import with a lower --exposure"
        )


def _claim(sequence: ImportedSequence, header: Header, folder: Path) -> None:
    """Mark the folder as an import of this sequence. Raises SourceError if it is another's."""
    key, stored_key = _content_key(sequence, header), store.read_text(folder / SOURCE_FILE)
    if folder.is_symlink():
        raise SourceError(
            f"{folder} is a link, to {folder.resolve()}, and no clip is written through one; "
            "remove it, or import into another --out"
        )
    paths.remove_temporaries(folder)
    is_used = stored_key or any(folder.glob("*.exr")) or (folder / FILE).exists()
    if is_used and stored_key != key:
        raise SourceError(
            f"{folder} holds a clip from elsewhere, or from these files before they changed; "
            "move it away, or import into another --out"
        )
    store.claim(folder / SOURCE_FILE, key)


def _content_key(sequence: ImportedSequence, header: Header) -> str:
    """What decides the frames: names, sizes and times of all files, and what is read from them."""
    stamps = [(path.name, path.stat().st_size, path.stat().st_mtime_ns) for path in sequence.files]
    content = (stamps, sequence.numbers, header.pool_spp, header.buffers, file_kinds(header.pools))
    text = repr(content) + sequence.convention
    return f"{sequence.sampler}\n{sha256(text.encode()).hexdigest()}\n"


def _images(count: int) -> str:
    return f"{count} image{'s' * (count != 1)}"
