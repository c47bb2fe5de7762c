"""What the noise of references hides: the ceiling of each clip, leads with and without it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pandas as pd

from reports.analysis.differences import (
    VERDICT_NOTE,
    correct_by_holm,
    difference_columns,
    difference_notes,
)
from reports.analysis.intervals import UNKNOWN
from reports.analysis.scores import HEADLINE, Scores, mean_over_scenes
from reports.layout.page import Section, write_report
from reports.layout.tables import Table, format_difference, rank_rows
from rlbench.benchmark.results import NOISE_CEILING

PLAIN, DEBIASED = HEADLINE
BASE = "ours"  # whose leads are measured; those of the best method where it was not measured
LEADS = ["metric", "method", "target_spp", "base", "mean", *difference_columns(UNKNOWN)]


def write(results: pd.DataFrame, folder: Path, name: str = "reference-noise") -> list[Path]:
    """Write PSNR beside debiased PSNR, and the noise ceiling of clips, see `write_report`."""
    missing = (
        "no method has psnr and psnr_debiased, which needs clips with two independent halves "
        "of the reference; rlbench run scores both"
    )
    return write_report(results, folder, name, "Noise of the references", _section, missing)


def _section(scores: Scores) -> Section | None:
    leads = correct_by_holm(measure_leads(scores))
    if leads.empty:
        return None
    clips = clip_ceilings(scores)
    tables = [_lead_table(part, spp) for spp, part in leads.groupby("target_spp")]
    tables += [_ceiling_table(clips)] if len(clips) else []
    lists = {"Differences": difference_notes(leads)}
    return Section(scores.device, tables, pd.concat([leads, clips]), lists)


def clip_ceilings(scores: Scores) -> pd.DataFrame:
    """Columns scene, clip, ceiling, best and best_method, in dB, means over the frames of a clip.

    `best` is the highest PSNR of any method at any budget. Clips whose header names no noise
    ceiling are left out.
    """
    stated = replace(scores, metric=NOISE_CEILING).measured
    frames = stated.drop_duplicates(["scene", "clip", "frame"])
    ceilings = frames.groupby(["scene", "clip"])["value"].mean().rename("ceiling").reset_index()
    means = scores.clip_means.sort_values("value", ascending=False)
    best = means.drop_duplicates("clip").rename(columns={"value": "best", "method": "best_method"})
    return ceilings.merge(best[["clip", "best", "best_method"]], on="clip", how="left")


def measure_leads(scores: Scores) -> pd.DataFrame:
    """A record of each metric, method and budget: its mean, and the lead of a base over it.

    The base is `ours`, or the best method by PSNR where `ours` has no score at that budget. Columns
    metric, method, target_spp, base, mean, and those of `difference_columns`.
    """
    parts = {metric: replace(scores, metric=metric) for metric in HEADLINE}
    keys = ["method", "target_spp"]
    means = {m: mean_over_scenes(each.scene_means).set_index(keys) for m, each in parts.items()}
    both = means[PLAIN].join(means[DEBIASED], rsuffix="_debiased", how="inner").reset_index()
    records = []
    for spp, ranked in both.sort_values("value", ascending=False).groupby("target_spp"):
        methods = list(ranked["method"])
        base = BASE if BASE in methods else methods[0]
        for metric in HEADLINE:
            for method in methods:
                is_base = method == base
                gap = UNKNOWN if is_base else parts[metric].gap(base, method, float(str(spp)))
                mean = float(means[metric].loc[(method, spp), "value"])
                named = {"metric": metric, "method": method, "target_spp": spp, "base": base}
                records.append(named | {"mean": mean} | difference_columns(gap))
    return pd.DataFrame(records, columns=LEADS)


def _lead_table(leads: pd.DataFrame, spp: object) -> Table:
    cells = {(row["method"], row["metric"]): row for row in leads.to_dict("records")}
    base = leads["base"].iloc[0]
    rows = []
    for method in rank_rows(leads[leads["metric"] == PLAIN], "mean"):
        both = [cells[method, metric] for metric in HEADLINE]
        scores = (f"{row['mean']:.2f}" for row in both)
        gaps = ("-" if method == base else format_difference(row) for row in both)
        rows.append((method, *scores, *gaps))
    header = ("method", "PSNR", "debiased", f"lead of {base}", f"lead of {base}, debiased")
    note = (
        "Means over scenes in dB, peak 1, clipped sRGB. Debiased: mean((x-a)(x-b)) with two "
        "independent halves a and b of the reference, whose noise PSNR counts as error. "
        f"{VERDICT_NOTE}"
    )
    title = f"PSNR with and without the reference's noise at {spp:g} spp"
    return Table(title, "", header, tuple(rows), note)


def _ceiling_table(clips: pd.DataFrame) -> Table:
    rows = tuple(
        (row["clip"], f"{row['ceiling']:.2f}", f"{row['best']:.2f}", row["best_method"])
        for row in clips.to_dict("records")
    )
    caption = (
        "PSNR of the noise-free image against the reference in dB, which no image can exceed, mean "
        "over frames; the highest PSNR of any row at any budget, and its method."
    )
    header = ("clip", "noise ceiling", "highest PSNR", "method")
    return Table("Noise ceiling of each clip", caption, header, rows)
