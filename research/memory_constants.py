"""What the constants of the memory are worth: scores with others in their place.

Command: python -m research.memory_constants CLIPS --spp 1,4 --method ours
With --of sizes: other sizes in pixels, to ask whether they should grow with the frame. The score
is PSNR without the noise of the reference.

Networks stay as they are, so a change that a network would have to learn shows as less than it is.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from statistics import fmean
from types import ModuleType

import pandas as pd
from rich.progress import track

import baselines.accumulate.density as density
import baselines.accumulate.memory as memory
import baselines.accumulate.method as method_by_rule
from research.clips import add_clips, print_gains, read_cells
from rlbench import registry
from rlbench.clips.stored import open_clip
from rlbench.method import Method
from rlbench.ops import accumulation, antilag
from rlbench.run import run_clip

PROGRAM = "python -m research.memory_constants"
AS_THEY_ARE = "as they are"

Constants = Mapping[tuple[ModuleType, str], float | tuple[int, ...]]
CHANGES: Mapping[str, Constants] = {
    AS_THEY_ARE: {},
    "fade with the surface 2": {(accumulation, "SURFACE_FALLOFF"): 2.0},
    "fade with the surface 1": {(accumulation, "SURFACE_FALLOFF"): 1.0},
    "fade with the surface 0.5": {(accumulation, "SURFACE_FALLOFF"): 0.5},
    "no fade with the surface": {(accumulation, "SURFACE_FALLOFF"): 0.0},
    "fade with depth 1": {(accumulation, "DEPTH_FALLOFF"): 1.0},
    "0.9 of the old weight": {(memory, "TRUST"): 0.9},
    "0.7 of the old weight": {(memory, "TRUST"): 0.7},
    "no blend": {(method_by_rule, "BLEND"): 0.0},
    "a blend of 0.45": {(method_by_rule, "BLEND"): 0.45},
    "changes from 3 errors": {(antilag, "NOISE_ERRORS"): 3.0},
}
# sizes in pixels; the rules were made on frames of 160 to 192
SIZES: Mapping[str, Constants] = {
    AS_THEY_ARE: {},
    "contrast in windows of 5": {(density, "CONTRAST_SIDE"): 5},
    "contrast in windows of 7, blurred over 7": {
        (density, "CONTRAST_SIDE"): 7,
        (density, "BLUR_SIDE"): 7,
    },
    "contrast blurred over 7": {(density, "BLUR_SIDE"): 7},
    "antilag in cells of 8": {(antilag, "CELL"): 8},
    "antilag in cells of 2": {(antilag, "CELL"): 2},
    "antilag in windows of 5 and 25 cells": {(antilag, "WINDOWS"): (5, 25)},
}
TABLES = {"memory": CHANGES, "sizes": SIZES}


@contextmanager
def constants(values: Constants) -> Iterator[None]:
    """Other constants in modules, until the end of the block."""
    before = {key: getattr(*key) for key in values}
    try:
        for key, value in values.items():
            setattr(*key, value)
        yield
    finally:
        for key, value in before.items():
            setattr(*key, value)


def measure_clip(
    folder: Path, spp: float, name: str, changes: Mapping[str, Constants]
) -> Iterator[dict[str, object]]:
    """Debiased PSNR in dB with each change, the mean over the frames of a clip."""
    method = registry.load_method(name, "cpu")
    for label, values in changes.items():
        with constants(values):
            psnr = mean_psnr(method, folder, spp)
        yield {"clip": folder.name, "spp": spp, "constants": label, "psnr": psnr}


def mean_psnr(method: Method, folder: Path, spp: float) -> float:
    """PSNR without the noise of the reference, in dB: the mean over the frames of a clip."""
    metric = registry.load_plugin("metrics", "psnr_debiased")
    clip = open_clip(folder, method.traits.inputs)
    scores: list[float] = []
    for result in run_clip(method, clip, spp):
        halves = result.frame.reference.half_a, result.frame.reference.half_b
        scores += metric.score(metric.compare(result.image, *halves)).tolist()
    return fmean(scores)


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(
        prog=PROGRAM,
        description="PSNR with other constants of the memory over that as they are, in dB.",
    )
    add_clips(parser)
    parser.add_argument("--method", default="ours", help="a row with a memory (default: ours)")
    parser.add_argument("--of", default="memory", choices=TABLES, help="which constants")
    arguments = parser.parse_args()
    changes = TABLES[arguments.of]
    cells = read_cells(parser, arguments)
    rows = [
        row
        for cell in track(cells, "measuring")
        for row in measure_clip(*cell, arguments.method, changes)
    ]
    table = pd.DataFrame(rows).pivot_table(
        index="constants", columns="spp", values="psnr", sort=False
    )
    print_gains("constants", table - table.loc[AS_THEY_ARE])


if __name__ == "__main__":
    main()
