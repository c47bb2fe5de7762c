"""References: two independent halves, traced in rounds until their noise limits no score."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from rlbench.clips.exr import read_exr
from rlbench.clips.frame_files import CHANNELS, exr_path
from rlbench.render.mitsuba.tracer import Tracer
from rlbench.render.presets import Preset
from rlbench.system import paths

HALVES = ("A", "B")
NOTES = "rounds.*.txt"  # beside the frames, where rounds end by themselves
HIGHEST = 100.0  # dB; the PSNR of equal images, by convention
KNEE = 0.0031308  # IEC 61966-2-1: the sRGB curve is straight below this linear value

Image = Float[Array, "h w 3"]


def trace_reference(
    tracer: Tracer, plan: Preset, exposure: float, traced: Callable[[int], None] = lambda spp: None
) -> tuple[Image, Image, int]:
    """Both halves of the reference, and the samples per pixel that they cost together.

    A round is `plan.reference_spp` samples for each half; there are `plan.rounds` at most, and no
    further one once the noise ceiling has reached `plan.ceiling_db`. That the rounds end where the
    halves happen to be alike makes their noise look smaller than it is, by a share of the order of
    one over the square root of the number of pixels. `traced` is told the samples per pixel of
    each launch, at the end those that were not needed.
    """
    totals = {half: np.zeros((tracer.height, tracer.width, 3)) for half in HALVES}
    for done in range(1, plan.max_reference_rounds + 1):
        first, spp = (done - 1) * plan.reference_spp, done * plan.reference_spp
        for half, total in totals.items():
            total += tracer.total(plan.reference_spp, f"reference{half}", first, traced=traced)
        a, b = ((total / spp).astype(np.float32) for total in totals.values())
        if done == plan.max_reference_rounds or ceiling_db(a, b, exposure) >= plan.ceiling_db:
            break
    traced(2 * plan.reference_spp * (plan.max_reference_rounds - done))
    return a, b, 2 * spp


def ceiling_db(a: Image, b: Image, exposure: float) -> float:
    """PSNR that the truth itself would score against the mean of two halves, in dB, at most 100.

    mean((A - B)^2) / 4 is what the noise of (A + B) / 2 adds to every squared error: unbiased, for
    the halves share no noise. A and B are exposed and shown in clipped sRGB, as for PSNR; the
    curve's bend within the noise is neglected.
    """
    apart = _display(a * exposure) - _display(b * exposure)
    noise = float(np.square(apart).mean()) / 4
    return min(HIGHEST, -10 * math.log10(max(noise, 10 ** (-HIGHEST / 10))))


def stored_ceiling_db(folder: Path, index: int, height: int, width: int, exposure: float) -> float:
    """The noise ceiling of a frame's files."""
    names = CHANNELS["rgb"]
    files = (exr_path(folder, f"reference{half}", index) for half in HALVES)
    a, b = (np.moveaxis(read_exr(file, names, height, width), 0, -1) for file in files)
    return ceiling_db(a, b, exposure)


def note(folder: Path, index: int, spp: int) -> None:
    """Remember what the reference of a frame cost, until the header says it."""
    with paths.replacing(_place(folder, index)) as path:
        path.write_text(f"{spp}\n")


def noted(folder: Path, index: int) -> int | None:
    """Samples per pixel that the reference of a frame cost, or None where there is no note."""
    place = _place(folder, index)
    return int(place.read_text()) if place.is_file() else None


def _place(folder: Path, index: int) -> Path:
    return folder / NOTES.replace("*", f"{index:04d}")


def _display(linear: Image) -> Image:
    """Clipped sRGB in [0, 1], float64 (IEC 61966-2-1)."""
    held = np.clip(linear.astype(np.float64), 0, 1)
    curved = 1.055 * np.maximum(held, KNEE) ** (1 / 2.4) - 0.055
    return np.where(held > KNEE, curved, 12.92 * held)
