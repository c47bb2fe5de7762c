"""Which step between `oidn` and `ours` costs on a frame without history: one row for each step.

Command: python -m research.first_frames CLIPS --spp 1,4

Each frame of a clip is a first frame: the method starts anew, so a clip of 8 frames gives 8.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path
from statistics import fmean
from typing import NamedTuple

import pandas as pd
import torch
from rich.console import Console
from rich.progress import track

from research.clips import add_clips, read_cells
from research.memory_constants import Constants, constants
from rlbench import registry
from rlbench.clips.in_memory import InMemoryClip
from rlbench.clips.stored import open_clip
from rlbench.frames import Frame
from rlbench.method import Method
from rlbench.ops import fireflies
from rlbench.run import run_clip

PROGRAM = "python -m research.first_frames"
SCORES = ("psnr", "psnr_debiased")


class Step(NamedTuple):
    """A row, and what distinguishes it from the row before."""

    method: str
    difference: str
    constants: Constants = {}  # of modules, as in memory_constants

    @property
    def label(self) -> str:
        """The row's name in the table."""
        return f"`{self.method}` | {self.difference}"


STEPS = (
    Step("oidn", "the U-Net, Intel's weights", {(fireflies, "CONTRAST"): 1e12}),
    Step("oidn", "fireflies limited"),
    Step("accumulate/intel", "behind the memory, which is empty"),
    Step("oidn/tuned", "weights tuned on single frames"),
    Step("oidn/filled", "holes filled, of which uniform samples leave none from 1 spp on"),
    Step("accumulate/tuned", "weights tuned behind the memory"),
    Step("ours/A2", "reads history too, trained with it"),
    Step("ours/flat", "weights trained with a sampler, sampled uniformly"),
    Step("ours", "the learned density, which knows no light yet"),
)


def start_anew(method: Method, frame: Frame, spp: float) -> torch.Tensor:
    """The image of a frame as the first of a clip, [1 3 h w]."""
    (result,) = run_clip(method, InMemoryClip("first", "first", "none", [frame]), spp)
    return result.image


def measure_clip(folder: Path, spp: float) -> Iterator[dict[str, object]]:
    """The scores in dB of each step, the mean over the frames of a clip."""
    metrics = {name: registry.load_plugin("metrics", name) for name in SCORES}
    for step in STEPS:
        method = registry.load_method(step.method, "cpu")
        found: dict[str, list[float]] = {name: [] for name in SCORES}
        with constants(step.constants):
            for frame in open_clip(folder, method.traits.inputs):
                halves = frame.reference.half_a, frame.reference.half_b
                image = start_anew(method, frame, spp)
                for name, metric in metrics.items():
                    found[name] += metric.score(metric.compare(image, *halves)).tolist()
        means = {name: fmean(values) for name, values in found.items()}
        yield {"clip": folder.name, "spp": spp, "step": step.label} | means


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(
        prog=PROGRAM,
        description="PSNR of first frames in dB, with the noise of the reference and without.",
    )
    add_clips(parser)
    cells = read_cells(parser, parser.parse_args())
    rows = [row for cell in track(cells, "measuring") for row in measure_clip(*cell)]
    table = pd.DataFrame(rows).pivot_table(
        index="step", columns="spp", values=list(SCORES), sort=False
    )
    console = Console(width=200)
    names = [f"{column[1]:g} spp{', debiased' * (column[0] != 'psnr')}" for column in table.columns]
    console.print(f"| row | step | {' | '.join(names)} |")
    console.print("| --- | --- |" + " ---: |" * len(names))
    for label, row in table.iterrows():
        console.print(f"| {label} | " + " | ".join(f"{value:.2f}" for value in row) + " |")


if __name__ == "__main__":
    main()
