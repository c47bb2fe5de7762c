"""PSNR of every clip: methods on moving cameras, cuts and static views."""

from __future__ import annotations

from pathlib import Path

import pandas as pd

from reports.analysis.aggregate import Scores, mean_over_scenes
from reports.analysis.comparability import check_comparable, split_by_device
from reports.analysis.intervals import (
    BOOTSTRAP_SAMPLES,
    INTERVAL_NOTE,
    mean_with_interval,
    pair,
)
from reports.layout.page import Section, write_page
from reports.layout.tables import Bold, Table, format_difference

__all__ = ["write"]

BASE = "ours"  # the method that others are compared with; the best method if it was not measured


def write(
    results: pd.DataFrame,
    folder: Path,
    name: str = "clips",
    seed: int = 0,
    draws: int = BOOTSTRAP_SAMPLES,
) -> list[Path]:
    """Write `name`.md, .csv and .tex: PSNR of each clip, a table per budget, best methods first.

    Each table ends with the mean over scenes, and with the difference of each method to `ours` (or
    to the best method if `ours` was not measured) and its interval. `seed` and `draws` are those of
    the bootstrap. Raises ReportError if a mean would mix rows that cannot be compared.
    """
    sections = []
    for device, rows in split_by_device(results).items():
        check_comparable(rows)
        scores = Scores(rows, device=device)
        budgets = sorted(set(scores.clip_means["target_spp"]))
        tables = [_clip_table(scores, spp, seed, draws) for spp in budgets]
        lists = {
            "Not run": scores.skip_reasons,
            "Left out of the means": scores.incomplete_groups,
            "Remarks": scores.remarks,
        }
        sections.append(Section(device, tables, scores.clip_means, lists))
    return write_page(folder, name, "PSNR by clip", results, sections)


def _clip_table(scores: Scores, spp: float, seed: int, draws: int) -> Table:
    clip_means, scene_means, per_frame = (
        part[part["target_spp"] == spp]
        for part in (scores.clip_means, mean_over_scenes(scores.scene_means), scores.per_frame)
    )
    overall = scene_means.set_index("method")["value"].sort_values(ascending=False)
    # methods that lack a scene have no mean and come last
    methods = list(dict.fromkeys([*overall.index, *clip_means["method"]]))
    base = BASE if BASE in overall.index else methods[0]
    clips = clip_means.pivot_table("value", ["scene", "clip"], "method").reindex(columns=methods)
    parts = {str(method): part for method, part in per_frame.groupby("method")}
    differences = {
        method: mean_with_interval(pair(parts[method], parts[base]), seed, draws)
        for method in overall.index
        if method != base
    }
    cells = {m: format_difference(gap.mean, gap.low, gap.high) for m, gap in differences.items()}
    rows = (
        *((str(clip), *_format_scores(line)) for clip, line in clips.droplevel("scene").iterrows()),
        ("mean over scenes", *_format_scores(overall.reindex(methods))),
        (f"minus {base}", *(cells.get(method, "-") for method in methods)),
    )
    caption = (
        f"{scores.convention}; mean over frames, the best of a row bold. Last row: mean over "
        f"scenes of the difference to {base}, paired by frame. Brackets: {INTERVAL_NOTE}; bold if "
        "it excludes zero."
    )
    return Table(f"PSNR [dB] at {spp:g} spp", caption, ("clip", *methods), rows)


def _format_scores(scores: pd.Series) -> list[str]:
    best = scores.max()
    cells = ["-" if value != value else f"{value:.2f}" for value in scores]
    return [Bold(x) if value == best else x for x, value in zip(cells, scores, strict=True)]
