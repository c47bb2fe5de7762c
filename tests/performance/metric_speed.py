"""Speed of SSIM and MS-SSIM against other libraries at 1080p, as a page of docs/results.

    python -m tests.performance.metric_speed docs/results/metric-speed.md

All run in turn in each round, so that a drift of the machine meets all alike; a ratio is that of
two times of one round.
"""

from __future__ import annotations

import importlib.metadata
import statistics
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path

import pytorch_msssim
import torch
from kornia.metrics import ssim as kornia_ssim
from torchmetrics.functional.image import (
    multiscale_structural_similarity_index_measure,
    structural_similarity_index_measure,
)

from metrics.ssim import ms_ssim, ssim
from rlbench.system import provenance

Similarity = Callable[[torch.Tensor, torch.Tensor], torch.Tensor]
OURS = "rlbench"
SSIM: dict[str, Similarity] = {
    OURS: ssim,
    "pytorch-msssim": lambda x, y: pytorch_msssim.ssim(x, y, data_range=1.0),
    "torchmetrics": lambda x, y: structural_similarity_index_measure(x, y, data_range=1.0),
    "kornia": lambda x, y: kornia_ssim(x, y, window_size=11).mean(),
}
MS_SSIM: dict[str, Similarity] = {
    OURS: ms_ssim,
    "pytorch-msssim": lambda x, y: pytorch_msssim.ms_ssim(x, y, data_range=1.0),
    "torchmetrics": lambda x, y: multiscale_structural_similarity_index_measure(
        x, y, data_range=1.0
    ),
}
METRICS = {"SSIM": SSIM, "MS-SSIM": MS_SSIM}
AIMS = {"pytorch-msssim": 2.0, "torchmetrics": 3.0}  # times as fast
HEIGHT, WIDTH = 1080, 1920
ROUNDS = 9


def image_pair(height: int, width: int) -> tuple[torch.Tensor, torch.Tensor]:
    """A noisy image and its reference, each [1 3 h w] in [0, 1]."""
    g = torch.Generator().manual_seed(0)
    reference = torch.rand(1, 3, height, width, generator=g)
    return (reference + 0.1 * torch.randn(reference.shape, generator=g)).clamp(0, 1), reference


def time_in_rounds(
    functions: Mapping[str, Similarity], pair: tuple[torch.Tensor, torch.Tensor], rounds: int
) -> dict[str, list[float]]:
    """Milliseconds of each function in each round, after one round that does not count."""
    times: dict[str, list[float]] = {name: [] for name in functions}
    for _ in range(rounds + 1):
        for name, function in functions.items():
            start = time.perf_counter()
            function(*pair)
            times[name].append(1e3 * (time.perf_counter() - start))
    return {name: each[1:] for name, each in times.items()}


def metric_rows(metric: str, height: int, width: int, rounds: int) -> list[str]:
    """A line of the table for each library: version, time, ratio with range, aim, value."""
    functions, pair = METRICS[metric], image_pair(height, width)
    with torch.inference_mode():
        values = {name: float(function(*pair)) for name, function in functions.items()}
        times = time_in_rounds(functions, pair, rounds)
    lines = []
    for name in functions:
        ratios = [other / own for other, own in zip(times[name], times[OURS], strict=True)]
        ratio = f"{statistics.median(ratios):.2f} [{min(ratios):.2f}, {max(ratios):.2f}]"
        aim = f"{AIMS[name]:g}" if name in AIMS else "-"
        cells = (
            f"{metric}, {name} {importlib.metadata.version(name)}",
            f"{statistics.median(times[name]):.0f}",
            *(("-", "-") if name == OURS else (ratio, aim)),
            f"{values[name]:.6f}",
        )
        lines.append(f"| {' | '.join(cells)} |")
    return lines


def page(height: int = HEIGHT, width: int = WIDTH, rounds: int = ROUNDS) -> str:
    """The page: what was measured on which machine, and a table."""
    header = ("metric and library", "ms", "times rlbench's", "at least", "value")
    lines = [
        "# Speed of SSIM and MS-SSIM",
        "",
        f"One image of {width}x{height}, {provenance.machine().name}, {torch.get_num_threads()} "
        f"threads, PyTorch {torch.__version__}. All run in turn in {rounds} rounds. Milliseconds: "
        "median. Times rlbench's: median over rounds of the ratio to rlbench's time in the same "
        "round, and in brackets the least and largest. At least: what the project asks for. "
        "torchmetrics and kornia pad the borders, so their values differ.",
        "",
        f"| {' | '.join(header)} |",
        f"| --- |{' ---: |' * (len(header) - 1)}",
        *(line for metric in METRICS for line in metric_rows(metric, height, width, rounds)),
    ]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    Path(sys.argv[1]).write_text(page(), encoding="utf-8")
