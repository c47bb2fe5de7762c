"""Equal latency: what networks of other sizes give in the frame time of `ours/latent`, as bars."""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
import pandas as pd

from reports.analysis.aggregate import Scores
from reports.analysis.comparability import check_comparable, split_by_device
from reports.analysis.intervals import BOOTSTRAP_SAMPLES
from reports.analysis.network_sizes import (
    BASE,
    SIZES,
    at_equal_latency,
    nearest_budget,
    select_sizes,
)
from reports.layout import style
from reports.layout.page import describe_clips
from reports.layout.size_bars import MAX_PANELS, draw_sizes
from reports.published import published
from rlbench.benchmark.results import MissingRowsError

__all__ = ["measure_sizes", "write"]


def write(
    results: pd.DataFrame,
    folder: Path,
    name: str = "equal-latency",
    seed: int = 0,
    draws: int = BOOTSTRAP_SAMPLES,
) -> list[Path]:
    """Write PNG, PDF and SVG of the figure and a CSV of its numbers, one set for each device.

    Rows are those of `SIZES`. With more than MAX_PANELS budgets those nearest to the paper's are
    drawn; the CSV has all. Raises MissingRowsError without scores and times of two sizes.
    """
    chosen, label = select_sizes(results)
    devices, files = split_by_device(chosen), []
    for device, rows in devices.items():
        check_comparable(rows)
        scores = Scores(rows, device=device)
        latencies = measure_sizes(scores, seed, draws)
        if latencies.empty:
            continue
        stem = name if len(devices) == 1 else f"{name}-{style.slug(device)}"
        with mpl.rc_context(style.RC):
            figure = draw_sizes(_select_budgets(latencies), SIZES, _caption(scores, label))
            files += style.save_figure(figure, folder, stem)
        latencies.to_csv(folder / f"{stem}.csv", index=False)
        files.append(folder / f"{stem}.csv")
    if not files:
        raise MissingRowsError(
            "no device has scores, times and the cost of a sample of ours/latent and of "
            "another size; rlbench run without --scores-only measures times"
        )
    return files


def measure_sizes(scores: Scores, seed: int = 0, draws: int = BOOTSTRAP_SAMPLES) -> pd.DataFrame:
    """`at_equal_latency` with the published budgets: empty without times of two sizes.

    Added columns: paper_spp and paper_share (samples in the paper's frame, and as a
    share of its base's; nan where it prints none).
    """
    found = at_equal_latency(scores, list(SIZES), BASE, seed, draws)
    if found.empty or found["method"].nunique() < 2:
        return pd.DataFrame()
    study = published().network_study
    printed = {times.row: times.spp for times in study.rows}
    spp = found["method"].map(printed).astype(float)
    return found.assign(paper_spp=spp, paper_share=spp / printed[study.rows[0].row])


def _select_budgets(latencies: pd.DataFrame) -> pd.DataFrame:
    """The budgets nearest to that of the paper's base."""
    left: set[float] = set(latencies["base_spp"])
    chosen: set[float] = set()
    while left and len(chosen) < MAX_PANELS:
        chosen.add(nearest_budget(left, published().network_study.rows[0].spp))
        left -= chosen
    return latencies[latencies["base_spp"].isin(chosen)]


def _caption(scores: Scores, label: str) -> str:
    study, paper = published().network_study, published()
    rows = f" Rows @{label}." * bool(label)
    return (
        f"PSNR, {scores.convention}; {describe_clips(scores.measured)}; inference on "
        f"{scores.device_name}; cost of a sample: {scores.cost_source or 'not named'}.{rows}\n"
        "Bars: PSNR at the best budget that fits the frame time of ours/latent, minus its own, "
        "paired; whiskers: 95 % interval over scenes; pale: not resolved. Number of samples per "
        "pixel beside them; >=: no larger budget was measured; ?: an unreliable time.\n"
        "Right: samples in the time of ours/latent, as a share of its own. Published: "
        f"{paper.title}, {study.source.partition(':')[0]}, frames of {study.frame_ms:g} ms on "
        f"{study.scene}; its PSNR is a figure without numbers."
    )
