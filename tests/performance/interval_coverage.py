"""How often the interval of a time on a busy machine holds the time on the quiet one.

The same rows are timed quiet, beside one and beside two busy loops, and quiet again; the quiet time
is the lesser of the first and the last, since other programs only add time.
`python -m tests.performance.interval_coverage OUT.md` writes a table. The machine must be quiet.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pandas as pd
import torch

from rlbench.benchmark.latency import device_name
from rlbench.benchmark.speed import Configuration, measure_speed

ROWS = ("mean", "svgf", "oidn", "accumulate/fast", "ours", "ntas")
SIZES = [(96, 96), (192, 192)]  # height, width
LOADS = (0, 1, 2, 0)  # busy loops
NAMES = ("quiet", "one busy loop", "two busy loops", "quiet, again")


@contextmanager
def busy_loops(count: int) -> Iterator[None]:
    """So many other programs that never sleep."""
    loops = [subprocess.Popen(["sh", "-c", "while :; do :; done"]) for _ in range(count)]
    try:
        yield
    finally:
        for loop in loops:
            loop.kill()
            loop.wait()


def time_rows(loops: int) -> pd.DataFrame:
    """Inference times with their intervals, beside busy loops."""
    with busy_loops(loops):
        table = measure_speed([Configuration(name) for name in ROWS], SIZES, torch.device("cpu"))
    return table.set_index(["method", "height"])


def describe(truth: pd.Series[float], busy: pd.DataFrame) -> dict[str, str]:
    """A line of the table: coverage, the estimate and the ends over the quiet time."""
    is_inside = (busy["inference_low_ms"] <= truth) & (truth <= busy["inference_high_ms"])
    ratios = {
        title: (busy[column] / truth).quantile([0.0, 0.5, 1.0]).tolist()
        for title, column in {
            "time": "inference_ms",
            "low end": "inference_low_ms",
            "high end": "inference_high_ms",
        }.items()
    }
    text = {name: f"{m:.2f} ({low:.2f} to {high:.2f})" for name, (low, m, high) in ratios.items()}
    return {"holds the quiet time": f"{is_inside.sum()} of {len(truth)}", **text}


def main(file: Path) -> None:
    """Time, and write the table."""
    tables = [time_rows(loops) for loops in LOADS]
    truth = tables[0]["inference_ms"].clip(upper=tables[-1]["inference_ms"])
    lines = [
        {"machine": name, **describe(truth, each)} for name, each in zip(NAMES, tables, strict=True)
    ]
    header = list(lines[0])
    table = [header, ["---", *["---:"] * (len(header) - 1)], *(list(x.values()) for x in lines)]
    rows = "\n".join(f"| {' | '.join(cells)} |" for cells in table)
    machine = device_name(torch.device("cpu"))
    file.write_text(f"{rows}\n\nRatios to the quiet time, median (least to largest); {machine}.\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
