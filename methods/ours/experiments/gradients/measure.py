"""Measure every gradient estimator against the exact gradient, and where ratios saturate.

Command: python -m methods.ours.experiments.gradients.measure --out docs/results
"""

from __future__ import annotations

import argparse
import csv
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from itertools import product
from pathlib import Path

import torch
from rich.progress import track

from methods.ours.experiments.gradients.estimators import ESTIMATORS, Measurement, measure
from methods.ours.experiments.gradients.exact_gradient import BUDGETS, DENOISERS
from methods.ours.experiments.gradients.ratio_saturation import SIDES, measure_saturation
from rlbench.system import paths

__all__ = ["GRADIENTS", "RATIOS", "gradient_row", "write_tables"]

PROGRAM = "python -m methods.ours.experiments.gradients.measure"
GRADIENTS, RATIOS = "gradients.csv", "importance_ratio.csv"
EXPLORED_DRAWS = 32  # of the slow reference, whose draws have little noise


def gradient_row(measurement: Measurement) -> dict[str, str]:
    """One row of the table of gradients; the direction is empty where noise hides it."""
    statistics = measurement.statistics
    row = {
        "estimator": measurement.estimator,
        "denoiser": measurement.denoiser,
        "spp": f"{measurement.spp:g}",
        "draws": str(measurement.draws),
        "has_scale": str(ESTIMATORS[measurement.estimator].has_scale),
    }
    for name in ("scale", "cosine", "bias"):
        interval = getattr(statistics, name)
        is_known = name == "scale" or statistics.is_resolved
        row[name] = f"{interval.value:.4g}" if is_known else ""
        row[f"{name}_margin"] = f"{interval.margin:.2g}" if is_known else ""
    return row | {"noise": f"{statistics.noise:.4g}", "frames": f"{statistics.frames_needed:.4g}"}


def write_tables(
    folder: Path, draws: int, budgets: Sequence[float] = BUDGETS, sides: Sequence[int] = SIDES
) -> None:
    """Measure, and write both tables to `folder`."""
    cells = list(product(ESTIMATORS, DENOISERS, budgets))
    rows = [
        gradient_row(measure(name, denoiser, spp, _number_of_draws(name, draws)))
        for name, denoiser, spp in track(cells, "gradients")
    ]
    _write(folder / GRADIENTS, rows)
    _write(folder / RATIOS, list(_ratio_rows(sides)))


def _number_of_draws(name: str, draws: int) -> int:
    return min(draws, EXPLORED_DRAWS) if name.endswith("truth") else draws


def _ratio_rows(sides: Sequence[int]) -> Iterator[Mapping[str, str]]:
    for side in sides:
        for saturation in measure_saturation(side):
            row = asdict(saturation)
            yield {key: f"{v:.4g}" if isinstance(v, float) else str(v) for key, v in row.items()}


def _write(file: Path, rows: Sequence[Mapping[str, str]]) -> None:
    with paths.atomic_write(file) as part, part.open("w", newline="") as out:
        writer = csv.DictWriter(out, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(
        prog=PROGRAM,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        description="Compare the gradient estimators that train a sampler with the exact gradient\n"
        f"of a toy problem, and write OUT/{GRADIENTS}. Count the importance ratios that\n"
        f"one step moves out of the clip range, and write OUT/{RATIOS}.\n"
        "Then draw the figures: python -m reports.gradients OUT",
        epilog=f"examples:\n  {PROGRAM} --out docs/results\n  {PROGRAM} --out /tmp/try --draws 64",
    )
    parser.add_argument(
        "--out", type=Path, default=Path("docs/results"), help="folder (default: docs/results)"
    )
    parser.add_argument(
        "--draws", type=int, default=512, help="gradients per measurement (default: 512)"
    )
    arguments = parser.parse_args()
    if arguments.draws < 2:
        parser.error(f"--draws {arguments.draws}: give 2 or more")
    torch.set_num_threads(1)
    write_tables(arguments.out, arguments.draws)


if __name__ == "__main__":
    main()
