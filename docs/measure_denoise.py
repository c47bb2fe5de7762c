"""Measure what rlbench denoise gives on means of 4, 16 and 64 spp: python docs/measure_denoise.py

On the clips of preset `development`. The mean of 4 spp is that of stored samples, 64 spp is half A
of the reference, and 16 spp is the mixture of 8 stored samples and half A that has its variance.
Half B is the truth; its own noise, known from the difference of both halves, is taken out of PSNR.
Writes docs/results/denoise.csv, a line for each row and number of samples.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator
from itertools import product
from pathlib import Path

import torch

import rlbench
from metrics.temporal import change_of_error, flicker, locate_previous, warped_error
from rlbench.clips.stored import find_all_clips
from rlbench.frames import Frame
from rlbench.method import Method
from rlbench.ops.color import encode_srgb
from rlbench.system.paths import cache_folder

ROWS = ("oidn", "accumulate/fast", "accumulate/tuned", "accumulate/intel")
SPP = (4, 16, 64)
FILE = Path(__file__).parent / "results" / "denoise.csv"


def mix(frame: Frame, spp: int) -> torch.Tensor:
    """A mean image with the variance of so many samples, independent of half B."""
    stored, converged = min(spp, 8), 64  # samples behind both images
    pool, half = frame.pool, frame.reference.half_a
    counts = torch.full((1, 1, *pool.size[1:]), stored)
    mean = pool.read(pool.empty(), counts)[:, :stored].mean(1)
    # weight b of the stored mean: b^2 / stored + (1 - b)^2 / converged = 1 / spp
    a, c = 1 / stored + 1 / converged, 1 / converged - 1 / spp
    b = (1 / converged + math.sqrt(converged**-2 - a * c)) / a
    return b * mean + (1 - b) * half


def measure(method: Method, frames: list[Frame], spp: int) -> Iterator[tuple[str, float]]:
    """Scores of a method on one clip, frame by frame."""
    noisy = (rlbench.NoisyFrame(each.gbuffer, mix(each, spp), spp) for each in frames)
    changes, previous = [], None
    for frame, image in zip(frames, rlbench.denoise(noisy, method, exposure=1.0), strict=True):
        half_a, half_b, shown = (
            encode_srgb(each.clamp(0, 1))
            for each in (frame.reference.half_a, frame.reference.half_b, image)
        )
        error = shown - half_b
        squared = error.square().mean() - (half_a - half_b).square().mean() / 2
        yield "psnr", -10 * math.log10(max(float(squared), 1e-7))
        if previous is not None:
            positions = locate_previous(error, frame.gbuffer.motion)
            changes.append(change_of_error(error, previous, positions))
            yield "warped_error", float(warped_error(changes[-1]))
        if len(changes) > 1:
            yield "flicker", float(flicker(changes[-1], changes[-2]))
        previous = error


def main() -> None:
    """Measure all rows and write the file."""
    clips = find_all_clips([cache_folder() / "clips" / "development"])
    methods = {row: rlbench.load_method(row) for row in ROWS}
    scores: dict[tuple[int, str], dict[str, list[float]]] = {}
    for folder in clips:
        frames = list(rlbench.open_clip(folder))
        for spp, row in product(SPP, ROWS):
            found = scores.setdefault((spp, row), {})
            for metric, value in measure(methods[row], frames, spp):
                found.setdefault(metric, []).append(value)
        write(scores)
        print(folder.name, flush=True)  # noqa: T201


def write(scores: dict[tuple[int, str], dict[str, list[float]]]) -> None:
    """Write the means over the frames so far."""
    lines = [
        {"row": row, "spp": spp, "frames": len(found["psnr"])}
        | {name: round(sum(values) / len(values), 4) for name, values in found.items()}
        for (spp, row), found in scores.items()
    ]
    with FILE.open("w", newline="") as file:
        writer = csv.DictWriter(file, list(lines[0]))
        writer.writeheader()
        writer.writerows(lines)


if __name__ == "__main__":
    main()
