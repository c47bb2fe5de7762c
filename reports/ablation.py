"""The ablation table: each variant of a family held against the family's default, pair by pair."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pandas as pd

from reports.analysis import aggregate, method_names, variant_differences
from reports.analysis.intervals import DRAWS, INTERVAL_NOTE
from reports.analysis.variant_differences import METRIC
from reports.layout import page
from reports.layout.tables import Grid, gap_text, wide
from reports.published import published


def write(
    table: pd.DataFrame,
    folder: Path,
    name: str = "ablation",
    family: str = "",
    seed: int = 0,
    draws: int = DRAWS,
) -> list[Path]:
    """`name`.md, .csv and .tex of one family: `family`, or ours, or that of most variants.

    Rows METHOD@NAME are left out, unless the family has none without a name and all have the same:
    then these are compared, and the title tells it.

    Raises LacksError if the family has no variant here besides its default, and ReportError where
    rows would be averaged that must not be.
    """
    title = "Ablations of {}"
    methods = set(table["method"])
    named = {method for method in methods if method_names.weights(method)}
    called, families = set(map(method_names.weights, named)), set(map(method_names.family, named))
    if len(called) == 1 and families.isdisjoint(map(method_names.family, methods - named)):
        title += f", rows @{called.pop()}"
        table = table.assign(method=table["method"].map(method_names.row))
    family = variant_differences.chosen(table, family)
    sections = []
    for device, rows in aggregate.by_device(table).items():
        rows = rows[rows["method"].map(method_names.family) == family]
        if not variant_differences.families_with_scores(rows).get(family):
            continue
        aggregate.check(rows)
        found = variant_differences.differences(rows, family, seed, draws)
        grids = [_score_grid(rows, found, family), _time_grid(rows, found, family, device)]
        grids.append(_change_grid(rows, found, family))
        sections.append(page.Section(device, grids, found, _lists(rows, found, family)))
    return page.write(folder, name, title.format(family), table, sections)


def _score_grid(table: pd.DataFrame, found: pd.DataFrame, family: str) -> Grid:
    base = published().of(family)
    head, body = wide(found, lambda row: gap_text(row["difference"], row["low"], row["high"]))
    stated = {line[0]: published().of(line[0]) for line in body}
    if base and any(stated.values()):
        head = (*head, f"paper, {published().spp:g} spp")
        body = [
            (*line, f"{s.psnr_db - base.psnr_db:+.1f}" if (s := stated[line[0]]) else "-")
            for line in body
        ]
    caption = (
        f"PSNR in dB ({aggregate.column_text(table, METRIC, 'convention')})"
        f" of each variant less that of "
        f"{family}, paired by scene, clip, frame, budget and seed; mean over scenes. In brackets: "
        f"{INTERVAL_NOTE}; bold where it excludes zero. Another training would differ too."
    )
    if base and any(stated.values()):
        caption += f" Paper: difference in {published().source}, {published().title}."
    return Grid(f"PSNR less that of {family}", caption, head, tuple(body))


def _time_grid(table: pd.DataFrame, found: pd.DataFrame, family: str, device: str) -> Grid:
    head, body = wide(
        found, lambda row: "-" if pd.isna(row["frame_ms"]) else f"{row['frame_ms']:+.1f}"
    )
    caption = (
        f"Whole frame in ms (plan + denoise, p50, + samples) less that of {family}, mean over "
        f"scenes, on {device or 'a device not named'}; networks are timed on one clip of each "
        f"size, so a few ms are noise; cost of a sample: "
        f"{aggregate.profile(table) or 'not measured'}."
    )
    return Grid(f"Frame time less that of {family}", caption, head, tuple(body))


def _change_grid(table: pd.DataFrame, found: pd.DataFrame, family: str) -> Grid:
    head, body = wide(found, lambda row: str(row["pairs"]))
    lines = tuple((*line, variant_differences.changes(table, line[0], family)) for line in body)
    caption = (
        f"Settings are those that {family} and its variants wrote into the results, default -> "
        "variant; rlbench list methods says which question each answers. Numbers: pairs of scores."
    )
    return Grid("What each changes, and pairs", caption, (*head, "settings"), lines)


def _lists(table: pd.DataFrame, found: pd.DataFrame, family: str) -> dict[str, list[str]]:
    rows: list[dict[str, Any]] = [dict(row) for _, row in found.iterrows()]
    odd = [
        "{method} at {target_spp:g} spp: {alone} scores without a partner, {pairs} pairs".format(
            **row
        )
        for row in rows
        if row["alone"]
    ]
    held = {(row["method"], row["target_spp"]) for row in rows}
    absent = [
        f"{method} at {spp:g} spp: not scored, or {family} is not"
        for method in variant_differences.families_with_scores(table)[family]
        for spp in sorted(set(variant_differences.scored(table)["target_spp"]))
        if (method, spp) not in held
    ]
    shown = set(found["method"])
    stated = [
        s for s in published().table if method_names.family(s.row) == family and s.row != family
    ]
    return {
        "Scores without a partner": odd,
        "Not compared": absent,
        "Variants of the paper that are not here": [
            f"{s.name}, here {s.row}" for s in stated if s.row not in shown
        ],
        "Not run": aggregate.reasons(table[table["metric"] == METRIC]),
        "Remarks": aggregate.remarks(table[table["metric"] == METRIC]),
    }
