"""The winner map: the best method for each deadline and cost of a sample."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pandas as pd
from numpy.typing import NDArray

from reports.analysis.aggregate import Scores
from reports.analysis.comparability import check_comparable, split_by_device
from reports.analysis.curves import Curve, curves_of, measured_sample_ms, methods_without_curve
from reports.analysis.intervals import interval_ends
from reports.analysis.verdicts import TIE_DB
from reports.analysis.winner import NOTHING, Winners, find_winners
from reports.layout import style
from reports.layout.page import describe_clips
from reports.layout.winner_map import MapLabels, WinnerMap, draw_winner_map
from rlbench.benchmark.results import MissingRowsError

__all__ = ["map_winners", "write"]

SAMPLE_MS = (0.1, 1000.0)  # of the vertical axis
COLUMNS, ROWS = 400, 300  # of the map
CSV_STEP = 5  # rows and columns of the map from one row of the CSV to the next
MAP_DRAWS = 1000  # of the bootstrap; the ends of an interval are then stable to about 3 %
LONGEST_MS = 10_000.0  # of the horizontal axis
ROUNDING = 50  # steps a factor e, in which the budgets of compared methods are rounded


def write(
    results: pd.DataFrame,
    folder: Path,
    metric: str = "psnr",
    name: str = "winners",
    seed: int = 0,
    draws: int = MAP_DRAWS,
) -> list[Path]:
    """Write PNG, PDF and SVG of the map and a CSV of its cells, one set for each device.

    Each cell has the method with the best mean score over scenes whose frame time fits the
    deadline. A cell is hatched where it ties with the runner-up, where their difference is not
    resolved, or where there is no interval. Raises MissingRowsError if no method has scores
    and times on every scene.
    """
    devices, files = split_by_device(results), []
    for device, rows in devices.items():
        check_comparable(rows)
        scores = Scores(rows, metric, device)
        curves = curves_of(scores)
        if not curves or not scores.direction:
            raise MissingRowsError(
                f"a map of winners needs {metric} and times of a method on every scene; found: "
                f"{'; '.join(methods_without_curve(scores, [])) or 'none'}. Measure with "
                "rlbench run"
            )
        stem = name if len(devices) == 1 else f"{name}-{style.slug(device)}"
        margin = TIE_DB if scores.column_text("unit") == "dB" else 0.0
        winners = replace(map_winners(curves, seed, draws), tie_margin=margin)
        with mpl.rc_context(style.RC):
            files += style.save_figure(
                draw_winner_map(winners, _labels(scores, curves)), folder, stem
            )
        files.append(folder / f"{stem}.csv")
        winners.table(CSV_STEP).to_csv(files[-1], index=False)
    return files


def map_winners(curves: Sequence[Curve], seed: int = 0, draws: int = MAP_DRAWS) -> WinnerMap:
    """The winner, the runner-up and their difference for each deadline and cost of a sample."""
    costs = np.geomspace(*SAMPLE_MS, ROWS)
    shortest = min(float(curve.frame_ms(SAMPLE_MS[0]).min()) for curve in curves)
    longest = max(float(curve.frame_ms(SAMPLE_MS[1]).max()) for curve in curves)
    span = (max(shortest / 1.5, 1.0), min(longest * 1.5, LONGEST_MS))
    deadlines = np.geomspace(*span, COLUMNS)
    sample_ms, deadline_ms = (grid.ravel() for grid in np.meshgrid(costs, deadlines, indexing="ij"))
    winners = find_winners(curves, sample_ms, deadline_ms)
    mean, low, high = _differences(curves, winners, seed, draws)
    first = winners.first
    spp = np.take_along_axis(winners.spp, first[None], axis=0)[0]  # NOTHING reads the last: nan
    largest = np.array([curve.spp[-1] for curve in curves])[first]
    shape = (ROWS, COLUMNS)
    return WinnerMap(
        methods=tuple(curve.method for curve in curves),
        sample_ms=costs,
        deadline_ms=deadlines,
        winner=first.reshape(shape),
        runner_up=winners.second.reshape(shape),
        spp=np.where(first == NOTHING, np.nan, spp).reshape(shape),
        is_at_largest=((first != NOTHING) & (spp == largest)).reshape(shape),
        difference=mean.reshape(shape),
        low=low.reshape(shape),
        high=high.reshape(shape),
    )


def _differences(
    curves: Sequence[Curve], winners: Winners, seed: int, draws: int
) -> tuple[NDArray[np.float64], ...]:
    """Mean, low and high [n] of the winner minus the runner-up; nan without a runner-up."""
    result = np.full((3, winners.order.shape[1]), np.nan)
    first, second = winners.first, winners.second
    for pair in np.unique(np.stack([first, second]), axis=1).T:
        if NOTHING in pair:
            continue
        (places,) = np.nonzero((first == pair[0]) & (second == pair[1]))
        budgets = np.stack([_rounded(curves[i], winners.spp[i, places]) for i in pair])
        known, where = np.unique(budgets, axis=1, return_inverse=True)
        units = curves[pair[0]].units_at(known[0]) - curves[pair[1]].units_at(known[1])
        ends = interval_ends(units.T, seed, draws)
        result[:, places] = np.stack([units.mean(axis=1), *ends])[:, where.ravel()]
    return tuple(result)


def _rounded(curve: Curve, spp: NDArray[np.float64]) -> NDArray[np.float64]:
    """Budgets to the nearest of few, so that equal comparisons are computed once."""
    positive = np.where(spp > 0, spp, 1.0)
    near = np.exp(np.round(np.log(positive) * ROUNDING) / ROUNDING)
    return np.where(spp > 0, near.clip(curve.spp[0], curve.spp[-1]), 0.0)


def _labels(scores: Scores, curves: Sequence[Curve]) -> MapLabels:
    sizes = sorted(set(scores.measured["size"]) - {""})
    at_size = f" at {', '.join(sizes)}" if sizes else ""
    missing = "".join(f"\n{line}." for line in methods_without_curve(scores, curves))
    return MapLabels(
        caption=(
            f"Best mean {scores.metric.upper()} over scenes, {describe_clips(scores.measured)}. "
            "Frame time without the G-buffer: plan + allocate + denoise on "
            f"{scores.device_name}{at_size}\n+ samples per pixel x cost of a sample. "
            "Between measured budgets scores are linear in log spp; none is extrapolated." + missing
        ),
        measured_ms=measured_sample_ms(scores),
    )
