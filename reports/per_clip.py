"""PSNR of every clip: methods on moving cameras, cuts and static views."""

from __future__ import annotations

from pathlib import Path

import pandas as pd

from reports.analysis.aggregate import Scores, mean_over_scenes
from reports.analysis.comparability import check_comparable, split_by_device
from reports.analysis.intervals import BOOTSTRAP_SAMPLES, UNKNOWN, mean_with_interval, pair
from reports.analysis.multiplicity import correct_by_holm, difference_columns, difference_notes
from reports.analysis.verdicts import VERDICT_NOTE
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
        means = mean_over_scenes(scores.scene_means)
        records = _differences(scores, means, seed, draws)
        budgets = sorted(set(scores.clip_means["target_spp"]))
        tables = [_clip_table(scores, means, records, spp) for spp in budgets]
        lists = {
            "Differences": difference_notes(records),
            "Not run": scores.skip_reasons,
            "Left out of the means": scores.incomplete_groups,
            "Remarks": scores.remarks,
        }
        clips_and_differences = pd.concat([scores.clip_means, records])
        sections.append(Section(device, tables, clips_and_differences, lists))
    return write_page(folder, name, "PSNR by clip", results, sections)


def _differences(scores: Scores, means: pd.DataFrame, seed: int, draws: int) -> pd.DataFrame:
    """A record for each method and budget: its difference to BASE, or to the best without BASE."""
    parts = {key: part for key, part in scores.per_frame.groupby(["method", "target_spp"])}
    records = []
    for spp, part in means.groupby("target_spp"):
        ranked = part.sort_values("value", ascending=False)["method"]
        base = BASE if BASE in set(ranked) else ranked.iloc[0]
        for method in ranked[ranked != base]:
            gap = mean_with_interval(pair(parts[method, spp], parts[base, spp]), seed, draws)
            keys = {"method": method, "target_spp": spp, "base": base}
            records.append(keys | difference_columns(gap))
    columns = ["method", "target_spp", "base", *difference_columns(UNKNOWN)]
    return correct_by_holm(pd.DataFrame(records, columns=columns))


def _clip_table(
    scores: Scores, means: pd.DataFrame, differences: pd.DataFrame, spp: float
) -> Table:
    clip_means, scene_means, records = (
        part[part["target_spp"] == spp] for part in (scores.clip_means, means, differences)
    )
    overall = scene_means.set_index("method")["value"].sort_values(ascending=False)
    # methods that lack a scene have no mean and come last
    methods = list(dict.fromkeys([*overall.index, *clip_means["method"]]))
    clips = clip_means.pivot_table("value", ["scene", "clip"], "method").reindex(columns=methods)
    cells = {row["method"]: format_difference(row) for row in records.to_dict("records")}
    base = next((m for m in overall.index if m not in cells), methods[0])
    rows = (
        *((str(clip), *_format_scores(line)) for clip, line in clips.droplevel("scene").iterrows()),
        ("mean over scenes", *_format_scores(overall.reindex(methods))),
        (f"minus {base}", *(cells.get(method, "-") for method in methods)),
    )
    note = (
        f"{scores.convention}; mean over frames, the best of a row bold. Last row: mean over "
        f"scenes of the difference to {base}, paired by frame. {VERDICT_NOTE}"
    )
    return Table(f"PSNR [dB] at {spp:g} spp", "", ("clip", *methods), rows, note)


def _format_scores(scores: pd.Series) -> list[str]:
    best = scores.max()
    cells = ["-" if value != value else f"{value:.2f}" for value in scores]
    return [Bold(x) if value == best else x for x, value in zip(cells, scores, strict=True)]
