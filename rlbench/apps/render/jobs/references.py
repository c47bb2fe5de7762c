"""References: two independent halves, traced until their noise no longer limits scores."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from numpy import ndarray as Array

from rlbench.apps.render.mitsuba.tracer import Tracer
from rlbench.clips.exr import read_exr
from rlbench.clips.frame_files import CHANNELS, exr_path
from rlbench.clips.presets import Preset
from rlbench.ops.color import encode_srgb
from rlbench.system import store

HALVES = ("A", "B")
SPP_FILES = "rounds.*.txt"  # beside the frames, if the number of rounds varies
MAX_DB = 100.0  # PSNR of equal images, by convention

Image = Float[Array, "h w 3"]


def trace_reference(
    tracer: Tracer,
    preset: Preset,
    exposure: float,
    on_samples: Callable[[int], None] = lambda spp: None,
) -> tuple[Image, Image, int]:
    """Both halves of the reference, and the samples per pixel of both together.

    Each round adds `preset.reference_spp` samples to each half. Rounds end after
    `preset.max_reference_rounds`, or once the noise ceiling reaches `preset.min_noise_ceiling_db`.
    Stopping where the halves happen to agree underestimates their noise by a fraction of the order
    of 1 / sqrt(number of pixels). `on_samples` receives the samples per pixel of each launch, and
    at the end those of the rounds that were not needed.
    """
    totals = {half: np.zeros((tracer.height, tracer.width, 3)) for half in HALVES}
    for rounds in range(1, preset.max_reference_rounds + 1):
        first, spp = (rounds - 1) * preset.reference_spp, rounds * preset.reference_spp
        for half, total in totals.items():
            total += tracer.trace_sum(
                preset.reference_spp, f"reference{half}", first, on_samples=on_samples
            )
        a, b = ((total / spp).astype(np.float32) for total in totals.values())
        if (
            rounds == preset.max_reference_rounds
            or noise_ceiling_db(a, b, exposure) >= preset.min_noise_ceiling_db
        ):
            break
    on_samples(2 * preset.reference_spp * (preset.max_reference_rounds - rounds))
    return a, b, 2 * spp


def noise_ceiling_db(a: Image, b: Image, exposure: float) -> float:
    """PSNR of the noise-free image against the mean of two halves, in dB, at most 100.

    mean((A - B)^2) / 4 is what the noise of (A + B) / 2 adds to the mean squared error. The
    estimate is unbiased because the halves are independent. As for PSNR, A and B are exposed,
    clipped to [0, 1] and encoded as sRGB; the curvature of sRGB within the noise is neglected.
    """
    difference = _display(a * exposure) - _display(b * exposure)
    noise = float(np.square(difference).mean()) / 4
    return min(MAX_DB, -10 * math.log10(max(noise, 10 ** (-MAX_DB / 10))))


def stored_noise_ceiling_db(
    folder: Path, index: int, height: int, width: int, exposure: float
) -> float:
    """The noise ceiling of a frame on disk, in dB."""
    names = CHANNELS["rgb"]
    files = (exr_path(folder, f"reference{half}", index) for half in HALVES)
    a, b = (np.moveaxis(read_exr(file, names, height, width), 0, -1) for file in files)
    return noise_ceiling_db(a, b, exposure)


def write_spp(folder: Path, index: int, spp: int) -> None:
    """Store the samples per pixel of a frame's reference until the clip has a header."""
    store.write_text(_spp_file(folder, index), f"{spp}\n")


def read_spp(folder: Path, index: int) -> int | None:
    """The stored samples per pixel of a frame's reference, or None if there is no such file."""
    file = _spp_file(folder, index)
    return int(file.read_text()) if file.is_file() else None


def _spp_file(folder: Path, index: int) -> Path:
    return folder / SPP_FILES.replace("*", f"{index:04d}")


def _display(linear: Image) -> Float[Array, "h w 3"]:
    """Linear radiance, clipped to [0, 1] and encoded as sRGB, float64."""
    clipped = np.clip(linear.astype(np.float64), 0, 1)
    return np.asarray(encode_srgb(torch.from_numpy(clipped)).numpy())
