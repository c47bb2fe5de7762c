"""Camera jitter: engines that antialias over time move each frame's camera within a pixel.

With offsets o of the samples from the centres of pixels, a point at rest moves by o(t) - o(t - 1)
from a frame to the one before it. Motion of a clip is without that, as its reference is.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from rlbench.apps.dumps.importers.layout import Camera, Layout
from rlbench.apps.dumps.importers.sequence import ImportedFrame, ImportedSequence
from rlbench.errors import SourceError

MAX_OFFSET = 2.0  # pixels
MAX_FILE_BYTES = 2**24
LIMITATION = "reference jitter"
Offset = tuple[float, float]  # pixels, x right, y down


def halton_offset(index: int) -> Offset:
    """Entry `index` of the Halton sequence of bases 2 and 3, from 0 on, minus 0.5 (Halton 1960).

    It begins with the fraction of 1, as in the samples of DLSS and FSR.

    >>> halton_offset(0), halton_offset(2)
    ((0.0, -0.16666666666666669), (0.25, -0.3888888888888889))
    """

    def fraction(base: int) -> float:
        number, value, share = index + 1, 0.0, 1.0
        while number:
            number, digit = divmod(number, base)
            share /= base
            value += share * digit
        return value - 0.5

    return fraction(2), fraction(3)


def read_offsets(camera: Camera, source: Path) -> Callable[[int], Offset]:
    """A function from the number of frames since the first of the dump to the offset of a frame.

    Raises SourceError for a formula or a file that is not understood.
    """
    sign = (camera.scale, -camera.scale if camera.y == "up" else camera.scale)
    if match := re.fullmatch(r"halton (\d{1,4})", camera.jitter.strip().lower()):
        period = int(match[1])
        if not period:
            raise SourceError("[camera] jitter has the period 0, expected for example 'halton 16'")

        def read_table(index: int) -> Offset:
            return halton_offset((index + camera.first) % period)

    else:
        table = _read_file(source / camera.jitter, camera.jitter)

        def read_table(index: int) -> Offset:
            row = max(index + camera.first, 0)  # none is before the first
            if row >= len(table):
                raise SourceError(
                    f"{source / camera.jitter} has {len(table)} offsets, and frame {index} after "
                    "the first needs another; write a line for each frame, also where they repeat"
                )
            return table[row]

    def read(index: int) -> Offset:
        x, y = read_table(index)
        return x * sign[0], y * sign[1]

    return read


def remove_jitter(sequence: ImportedSequence, layout: Layout, source: Path) -> ImportedSequence:
    """The sequence with the offsets of its samples, and with motion that is without them.

    Motion that is exactly 0 in a sky stays: no motion was written there. Raises SourceError for
    jittered motion without offsets.
    """
    has_motion = bool(layout.motion and layout.motion.jittered)
    if layout.camera is None:
        if has_motion or layout.reference.jittered:
            raise SourceError(
                "jittered = true needs [camera] jitter, 'halton 16' or a file of offsets; "
                "rlbench lint --guess looks for the formula"
            )
        return sequence
    offset, first = read_offsets(layout.camera, source), sequence.first_number
    has_motion = has_motion and "no motion" not in sequence.limitations
    has_motion = has_motion or "flow" in sequence.limitations  # of jittered albedo

    def read(number: int, samples: int) -> ImportedFrame:
        frame = sequence.read(number, samples)
        index = number - first
        change = np.subtract(offset(index), offset(index - 1))
        stored = frame.gbuffer["motion"]
        is_empty = np.isinf(frame.gbuffer["depth"]) & (stored == 0).all(-1, keepdims=True)
        motion = np.where(is_empty, stored, stored - change).astype(np.float32)
        return frame._replace(gbuffer={**frame.gbuffer, "motion": motion})

    offsets = tuple(offset(number - first) for number in sequence.numbers)
    is_moved = layout.reference.jittered
    largest = max(math.hypot(*each) for each in offsets)
    note = f"samples are up to {largest:.2f} pixels off a pixel's centre ({layout.camera.jitter})"
    reference = "jittered as they are" if is_moved else "not jittered"
    return replace(
        sequence,
        read=read if has_motion else sequence.read,
        jitter=offsets,
        limitations=(*sequence.limitations, *([LIMITATION] if is_moved else [])),
        notes=(*sequence.notes, f"{note}; the reference is {reference}"),
        files=(*sequence.files, *(source / name for name in layout.camera.files)),
    )


def _read_file(path: Path, name: str) -> Sequence[Offset]:
    """The offsets in a text file: x and y a line; # begins a comment. Raises SourceError."""
    if not path.is_file():
        found = f"and {path} is a folder" if path.is_dir() else f"and there is no file {path}"
        raise SourceError(
            f"[camera] jitter is '{name}', {found}; expected 'halton PERIOD', as in 'halton 16', "
            "or a file of offsets below the dump, a line of x and y for each frame"
        )
    if path.stat().st_size > MAX_FILE_BYTES:
        raise SourceError(f"{path} is too large for a file of offsets")
    table = []
    for number, line in enumerate(path.read_text("utf-8-sig", errors="replace").splitlines(), 1):
        words = line.partition("#")[0].replace(",", " ").replace(";", " ").split()
        if not words:
            continue
        try:
            x, y = (float(word) for word in words)
        except ValueError as error:
            raise SourceError(
                f"{path}, line {number}: '{line[:40]}' is not an offset; "
                "expected x and y, in pixels"
            ) from error
        if not max(abs(x), abs(y)) <= MAX_OFFSET:
            raise SourceError(
                f"{path}, line {number}: the offset is ({x:g}, {y:g}), expected pixels from the "
                f"centre of a pixel, at most {MAX_OFFSET:g}"
            )
        table.append((x, y))
    if not table:
        raise SourceError(f"{path} holds no offset; write x and y, a line for each frame")
    return table
