"""The summary: every score and time by method and budget, how sure, and what was not run."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import pandas as pd

from reports.analysis import aggregate
from reports.analysis.intervals import DRAWS, INTERVAL_NOTE
from reports.analysis.ranking import EVERY, ranking
from reports.layout import page
from reports.layout.tables import Bold, Grid

TIME_COLUMNS = {
    "plan_ms": "plan p50",
    "plan_p95_ms": "plan p95",
    "denoise_ms": "denoise p50",
    "denoise_p95_ms": "denoise p95",
    "sampling_ms": "sampling",
    "frame_ms": "total",
}
Show = Callable[[float], str]


def write(
    table: pd.DataFrame, folder: Path, name: str = "summary", seed: int = 0, draws: int = DRAWS
) -> list[Path]:
    """`name`.md, .csv and .tex: scores, times, scenes and reasons, a section for each device.

    `seed` and `draws` are those of the bootstrap. Raises ReportError where rows would be averaged
    that must not be.
    """
    sections = []
    for device, rows in aggregate.by_device(table).items():
        aggregate.check(rows)
        ranks = [ranking(rows, metric, seed, draws) for metric in aggregate.metrics(rows)]
        grids = [*_score_grids(rows, ranks), *_time_grids(rows, device), *_scene_grids(rows, ranks)]
        records = pd.concat(ranks or [pd.DataFrame()])
        sections.append(page.Section(device, grids, records, _lists(rows)))
    return page.write(folder, name, "Summary", table, sections)


def _score_grids(table: pd.DataFrame, ranks: Sequence[pd.DataFrame]) -> list[Grid]:
    return [
        _grid(
            table,
            rank[rank["scene"] == EVERY],
            "mean over scenes",
            f"Bold is best at its budget. In brackets: {INTERVAL_NOTE} "
            "of the paired difference to the "
            "best; a tie is a difference whose interval holds zero.",
        )
        for rank in ranks
    ]


def _scene_grids(table: pd.DataFrame, ranks: Sequence[pd.DataFrame]) -> list[Grid]:
    first = ranks[0] if ranks else pd.DataFrame(columns=["scene"])
    return [
        _grid(table, rows, str(scene), "Bold is best at its budget.")
        for scene, rows in first.groupby("scene")
        if scene != EVERY
    ]


def _grid(table: pd.DataFrame, rank: pd.DataFrame, of: str, caption: str) -> Grid:
    metric = str(rank["metric"].iloc[0]) if len(rank) else "score"
    unit, better, convention = (
        aggregate.column_text(table, metric, c) for c in ("unit", "direction", "convention")
    )
    budgets, show = sorted(set(rank["target_spp"])), _shown(unit)
    cells = {(row.method, row.target_spp): _cell(row, show) for row in rank.itertuples()}
    body = tuple(
        (method, *(cells.get((method, spp), "-") for spp in budgets))
        for method in sorted(set(rank["method"]))
    )
    name = f"{metric} [{unit}]" if unit else metric
    head = ("method", *(f"{spp:g} spp" for spp in budgets))
    rule = {"higher": "Higher is better. ", "lower": "Lower is better. "}.get(better, "")
    return Grid(
        f"{name}, {of}", f"{convention}. {rule}{caption if better else 'Not ranked.'}", head, body
    )


def _cell(row: object, show: Show) -> str:
    mean, low, high = (getattr(row, name) for name in ("mean", "low", "high"))
    text = show(mean)
    if getattr(row, "best"):  # noqa: B009
        return Bold(text)
    if low == low:
        text += f" [{show(low)}, {show(high)}]"
    return f"{text} tie" if getattr(row, "tie") else text  # noqa: B009


def _shown(unit: str) -> Show:
    return (lambda v: f"{v:.2f}") if unit in ("dB", "ms") else (lambda v: f"{v:.3g}")


def _time_grids(table: pd.DataFrame, device: str) -> list[Grid]:
    metrics = aggregate.metrics(table)
    if not metrics:
        return []
    means = aggregate.overall(aggregate.points(table, metrics[0]))
    if means["frame_ms"].isna().all():
        return []
    head = ("method", "spp", "spp bought", *TIME_COLUMNS.values())
    body = tuple(
        (row["method"], f"{row['target_spp']:g}", f"{row['mean_spp']:.3g}")
        + tuple("-" if pd.isna(row[c]) else f"{row[c]:.2f}" for c in TIME_COLUMNS)
        for _, row in means.iterrows()
    )
    source = aggregate.profile(table) or "a source not named"
    caption = (
        f"Plan and denoise on {device or 'a device not named'}; sampling = samples bought per "
        f"pixel x time of one sample per pixel ({source}); total = plan and denoise p50 + sampling."
    )
    return [Grid("time of a frame [ms], mean over scenes", caption, head, body)]


def _lists(table: pd.DataFrame) -> dict[str, list[str]]:
    """What is missing, and notes on what is not."""
    missing = [
        line
        for metric in aggregate.metrics(table)
        for line in aggregate.incomplete_groups(table, metric)
    ]
    return {
        "Not run": aggregate.reasons(table),
        "Left out of the means": missing,
        "Remarks": aggregate.remarks(table),
    }
