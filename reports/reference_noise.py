"""What the noise of references hides: the ceiling of each clip, leads with and without it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pandas as pd

from reports.analysis.aggregate import HEADLINE, Scores, mean_over_scenes
from reports.analysis.comparability import check_comparable, split_by_device
from reports.analysis.intervals import BOOTSTRAP_SAMPLES, UNKNOWN, mean_with_interval, pair
from reports.analysis.multiplicity import correct_by_holm, difference_columns, difference_notes
from reports.analysis.verdicts import VERDICT_NOTE
from reports.layout.page import Section, write_page
from reports.layout.tables import Table, format_difference, rank_rows
from rlbench.benchmark.results import NOISE_CEILING, MissingRowsError

__all__ = ["clip_ceilings", "measure_leads", "write"]

PLAIN, DEBIASED = HEADLINE
BASE = "ours"  # whose leads are measured; those of the best method where it was not measured


def write(
    results: pd.DataFrame,
    folder: Path,
    name: str = "reference-noise",
    seed: int = 0,
    draws: int = BOOTSTRAP_SAMPLES,
) -> list[Path]:
    """Write `name`.md, .csv and .tex: PSNR beside debiased PSNR, and the noise ceiling of clips.

    `seed` and `draws` are those of the bootstrap. Raises MissingRowsError if no method has both
    scores, and ReportError if a mean would mix rows that cannot be compared.
    """
    sections = []
    for device, rows in split_by_device(results).items():
        check_comparable(rows)
        leads = correct_by_holm(measure_leads(rows, device, seed, draws))
        if leads.empty:
            continue
        clips = clip_ceilings(rows)
        budgets = sorted(set(leads["target_spp"]))
        tables = [_lead_table(leads[leads["target_spp"] == spp], spp) for spp in budgets]
        tables += [_ceiling_table(clips)] if len(clips) else []
        records = pd.concat([leads, clips])
        sections.append(Section(device, tables, records, {"Differences": difference_notes(leads)}))
    if not sections:
        raise MissingRowsError(
            "no method has psnr and psnr_debiased, which needs clips with two independent halves "
            "of the reference; rlbench run scores both"
        )
    return write_page(folder, name, "Noise of the references", results, sections)


def clip_ceilings(rows: pd.DataFrame) -> pd.DataFrame:
    """Columns scene, clip, ceiling, best and best_method, in dB, means over the frames of a clip.

    `best` is the highest PSNR of any method at any budget. Clips whose header names no noise
    ceiling are left out.
    """
    stated = rows[(rows["metric"] == NOISE_CEILING) & rows["value"].notna()]
    frames = stated.drop_duplicates(["scene", "clip", "frame"])
    ceilings = frames.groupby(["scene", "clip"])["value"].mean().rename("ceiling").reset_index()
    means = Scores(rows, PLAIN).clip_means.sort_values("value", ascending=False)
    best = means.drop_duplicates("clip").rename(columns={"value": "best", "method": "best_method"})
    return ceilings.merge(best[["clip", "best", "best_method"]], on="clip", how="left")


def measure_leads(
    rows: pd.DataFrame, device: str = "", seed: int = 0, draws: int = BOOTSTRAP_SAMPLES
) -> pd.DataFrame:
    """A record of each metric, method and budget: its mean, and the lead of a base over it.

    The base is `ours`, or the best method by PSNR where `ours` has no score at that budget. Columns
    metric, method, target_spp, base, mean, and those of `difference_columns`.
    """
    scores = {metric: Scores(rows, metric, device) for metric in HEADLINE}
    means = {metric: mean_over_scenes(each.scene_means) for metric, each in scores.items()}
    both = means[PLAIN].merge(means[DEBIASED][["method", "target_spp"]])
    records = [
        record
        for _, ranked in both.sort_values("value", ascending=False).groupby("target_spp")
        for metric in HEADLINE
        for record in _leads_at(scores[metric], means[metric], ranked, seed, draws)
    ]
    columns = ["metric", "method", "target_spp", "base", "mean", *difference_columns(UNKNOWN)]
    return pd.DataFrame(records, columns=columns)


def _leads_at(
    scores: Scores, means: pd.DataFrame, ranked: pd.DataFrame, seed: int, draws: int
) -> Iterator[dict[str, object]]:
    """The records of one metric and budget; `ranked` has the methods, best first."""
    methods, spp = list(ranked["method"]), ranked["target_spp"].iloc[0]
    base = BASE if BASE in methods else methods[0]
    at = means[means["target_spp"] == spp].set_index("method")["value"]
    frames = scores.per_frame[scores.per_frame["target_spp"] == spp]
    parts = {name: part for name, part in frames.groupby("method")}
    for method in methods:
        keys = {"metric": scores.metric, "method": method, "target_spp": spp, "base": base}
        gap = UNKNOWN
        if method != base:
            gap = mean_with_interval(pair(parts[base], parts[method]), seed, draws)
        yield keys | {"mean": float(at[method])} | difference_columns(gap)


def _lead_table(leads: pd.DataFrame, spp: float) -> Table:
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
    return Table(f"PSNR with and without the reference's noise at {spp:g} spp", "", header,
                 tuple(rows), note)  # fmt: skip


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
