"""Every clip by itself: who leads where the camera stands, a shot is cut, or nothing moves?"""

from __future__ import annotations

from pathlib import Path

import pandas as pd

from reports.analysis import aggregate
from reports.analysis.intervals import DRAWS, INTERVAL_NOTE, interval, paired
from reports.layout import page
from reports.layout.tables import Bold, Grid, gap_text

METRIC = "psnr"
BASE = "ours"  # what rows are held against, where it is there; else the best


def write(
    table: pd.DataFrame, folder: Path, name: str = "clips", seed: int = 0, draws: int = DRAWS
) -> list[Path]:
    """`name`.md, .csv and .tex: PSNR of each clip, a table a budget, best rows first.

    Each table ends with the mean over scenes, and with how far each method is from `ours`, or from
    the best where `ours` is not there, with its interval. `seed` and `draws` are those of the
    bootstrap. Raises ReportError where rows would be averaged that must not be.
    """
    sections = []
    for device, rows in aggregate.by_device(table).items():
        aggregate.check(rows)
        scored = rows[rows["metric"] == METRIC]
        means = aggregate.clip_means(scored, METRIC)
        whole = aggregate.overall(aggregate.scene_means(scored, METRIC))
        shots = aggregate.per_frame_scores(scored, METRIC)
        told = aggregate.column_text(scored, METRIC, "convention")
        budgets = sorted(set(means["target_spp"]))
        grids = [_grid(spp, means, whole, shots, told, seed, draws) for spp in budgets]
        lists = {
            "Not run": aggregate.reasons(scored),
            "Left out of the means": aggregate.incomplete_groups(scored, METRIC),
            "Remarks": aggregate.remarks(scored),
        }
        sections.append(page.Section(device, grids, means, lists))
    return page.write(folder, name, "Clip by clip", table, sections)


def _grid(
    spp: float,
    means: pd.DataFrame,
    whole: pd.DataFrame,
    shots: pd.DataFrame,
    convention: str,
    seed: int,
    draws: int,
) -> Grid:
    means, whole, shots = (part[part["target_spp"] == spp] for part in (means, whole, shots))
    overall = whole.set_index("method")["value"].sort_values(ascending=False)
    # what lacks a scene has no mean, and comes last
    methods = list(dict.fromkeys([*overall.index, *means["method"]]))
    base = BASE if BASE in overall.index else methods[0]
    wide = means.pivot_table("value", ["scene", "clip"], "method").reindex(columns=methods)
    parts = {str(method): part for method, part in shots.groupby("method")}
    gaps = {
        method: interval(paired(parts[method], parts[base]), seed, draws)
        for method in overall.index
        if method != base
    }
    told = {method: gap_text(gap.mean, gap.low, gap.high) for method, gap in gaps.items()}
    body = (
        *((str(clip), *_cells(line)) for clip, line in wide.droplevel("scene").iterrows()),
        ("mean over scenes", *_cells(overall.reindex(methods))),
        (f"less {base}", *(told.get(method, "-") for method in methods)),
    )
    caption = (
        f"{convention}; mean over frames, best of a line bold. "
        f"Last line: mean over scenes of the difference to {base}, paired by frame; in brackets "
        f"{INTERVAL_NOTE}; bold where it excludes zero."
    )
    return Grid(f"PSNR [dB] at {spp:g} spp", caption, ("clip", *methods), body)


def _cells(line: pd.Series) -> list[str]:
    best = line.max()
    shown = ["-" if value != value else f"{value:.2f}" for value in line]
    return [Bold(x) if value == best else x for x, value in zip(shown, line, strict=True)]
