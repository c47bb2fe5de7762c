"""The frame-time figure: the parts of a frame of each method, stacked, a panel for each budget."""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
import pandas as pd

from reports.analysis.aggregate import FRAME_PARTS, Scores, metrics_with_values
from reports.analysis.comparability import check_comparable, split_by_device
from reports.layout import style
from reports.layout.frame_bars import MAX_PANELS, draw_frame_bars
from reports.layout.page import describe_clips
from rlbench.benchmark.results import MissingRowsError

__all__ = ["frame_times", "write"]

COLUMNS = ["method", "target_spp", *FRAME_PARTS, "frame_ms", "unreliable"]


def write(results: pd.DataFrame, folder: Path, name: str = "frame-time") -> list[Path]:
    """Write PNG, PDF and SVG of the figure and a CSV of its numbers, one set for each device.

    With more than MAX_PANELS budgets the lowest, the highest and those between in equal steps are
    drawn; the CSV has all. Raises MissingRowsError if no method has a frame time.
    """
    devices, files = split_by_device(results), []
    timed = {
        device: scores for device, rows in devices.items() if (scores := _scores(rows, device))
    }
    if not timed:
        raise MissingRowsError(
            "no method has a frame time on every scene. Measure times with rlbench run; its option "
            "--cost takes sample_ms from a published profile"
        )
    for device, scores in timed.items():
        times = frame_times(scores)
        stem = name if len(timed) == 1 else f"{name}-{style.slug(device)}"
        with mpl.rc_context(style.RC):
            figure = draw_frame_bars(_select_budgets(times), _caption(scores))
            files += style.save_figure(figure, folder, stem)
        times.to_csv(folder / f"{stem}.csv", index=False)
        files.append(folder / f"{stem}.csv")
    return files


def frame_times(scores: Scores) -> pd.DataFrame:
    """The parts of a frame of each method and budget, mean over scenes; columns as in COLUMNS.

    The parts add up to `frame_ms`.
    """
    means = scores.overall
    return means.loc[means["frame_ms"].notna(), COLUMNS].reset_index(drop=True)


def _scores(rows: pd.DataFrame, device: str) -> Scores | None:
    """The scores of one device, or None if none of its methods has a frame time."""
    check_comparable(rows)
    metrics = metrics_with_values(rows)
    if not metrics:
        return None
    scores = Scores(rows, metrics[0], device)
    return scores if len(frame_times(scores)) else None


def _select_budgets(times: pd.DataFrame) -> pd.DataFrame:
    budgets = sorted(set(times["target_spp"]))
    last, count = len(budgets) - 1, min(len(budgets), MAX_PANELS)
    chosen = [budgets[round(i * last / max(count - 1, 1))] for i in range(count)]
    return times[times["target_spp"].isin(chosen)]


def _caption(scores: Scores) -> str:
    lines = [
        f"Mean over scenes; {describe_clips(scores.measured)}. Plan, allocate and denoise on "
        f"{scores.device_name}.",
        f"Sampling: drawn samples per pixel x time of one sample per pixel "
        f"({scores.cost_source or 'not named'}). G-buffer: for methods that read one.",
        *(f"Two devices: {mix}." for mix in scores.device_mixes),
    ]
    return "\n".join(lines)
