"""Which half precision loses less PSNR: bfloat16 (8 bits of significand) or float16 (11 bits)?

Command: python -m research.half_precision CLIPS -m oidn/tuned,ours --spp 1,4

A GPU computes in both. Few processors have instructions for float16, so convolutions and matrix
products are computed here from rounded inputs in float32, and their results are rounded: a tensor
core also sums products of halves in float32. All other operations are PyTorch's own in each dtype.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path
from statistics import fmean
from typing import Any

import pandas as pd
import torch
from rich.console import Console
from rich.progress import track
from torch.utils import _pytree as pytree
from torch.utils._python_dispatch import TorchDispatchMode

from research.clips import add_clips, read_cells
from rlbench import registry
from rlbench.clips.stored import open_clip
from rlbench.run import run_clip
from rlbench.wrappers import HalfPrecision

PROGRAM = "python -m research.half_precision"
CPU = torch.device("cpu")
PRECISIONS = ("float32", "bfloat16", "float16")
ATEN = torch.ops.aten
SUMS = (ATEN.convolution, ATEN.mm, ATEN.addmm, ATEN.bmm, ATEN.baddbmm)  # what a tensor core does


class SumInFloat32(TorchDispatchMode):  # type: ignore[no-untyped-call]
    """Inside, sums of products of float16 are computed in float32, and rounded to float16."""

    def __torch_dispatch__(
        self, function: Any, types: Any, args: Any = (), kwargs: Any = None
    ) -> Any:
        """The result of an operation."""
        inputs = (args, kwargs or {})
        halves = [x for x in pytree.tree_leaves(inputs) if _is_float16(x)]
        if not halves or function.overloadpacket not in SUMS:
            return function(*inputs[0], **inputs[1])
        wide = pytree.tree_map(lambda x: x.float() if _is_float16(x) else x, inputs)
        return function(*wide[0], **wide[1]).half()


def _is_float16(value: object) -> bool:
    return isinstance(value, torch.Tensor) and value.dtype == torch.float16


def measure_clip(methods: list[str], folder: Path, spp: float) -> Iterator[dict[str, object]]:
    """The mean PSNR in dB over a clip's frames, by method and precision."""
    metric = registry.load_plugin("metrics", "psnr")
    for name in methods:
        method = registry.load_method(name, CPU)
        clip = open_clip(folder, method.traits.inputs)
        halves = [(frame.reference.half_a, frame.reference.half_b) for frame in clip]
        scores = {}
        for precision in PRECISIONS:
            dtype = getattr(torch, precision)
            wrapped = method if dtype == torch.float32 else HalfPrecision(method, CPU, dtype)
            with SumInFloat32():  # type: ignore[no-untyped-call]
                images = [result.image for result in run_clip(wrapped, clip, spp)]
            scores[precision] = fmean(
                metric.score(metric.compare(image, *pair)).item()
                for image, pair in zip(images, halves, strict=True)
            )
        yield {"clip": folder.name, "spp": spp, "row": name} | scores


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(prog=PROGRAM, description="PSNR in dB in each precision.")
    add_clips(parser)
    parser.add_argument("-m", "--methods", required=True, help="rows, a,b")
    arguments = parser.parse_args()
    cells = read_cells(parser, arguments)
    methods = arguments.methods.split(",")
    rows = [row for cell in track(cells, "measuring") for row in measure_clip(methods, *cell)]
    table = pd.DataFrame(rows)
    single, *halves = PRECISIONS
    table[halves] = table[halves].sub(table[single], axis=0)
    losses = table.groupby("row", sort=False)[halves].agg(["mean", "min"])
    console = Console(width=120)
    console.print("| row | bfloat16: mean | worst clip | float16: mean | worst clip |")
    console.print("| --- |" + " ---: |" * 4)
    for name, row in losses.iterrows():
        console.print(f"| `{name}` | " + " | ".join(f"{value:+.3f}" for value in row) + " |")


if __name__ == "__main__":
    main()
