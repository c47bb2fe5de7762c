"""The network study: sizes of networks against those of `ours/latent`, beside the paper's."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pandas as pd

from reports.analysis.aggregate import Scores
from reports.analysis.comparability import check_comparable, split_by_device
from reports.analysis.intervals import BOOTSTRAP_SAMPLES
from reports.analysis.multiplicity import correct_by_holm, difference_notes
from reports.analysis.network_sizes import BASE, SIZES, nearest_budget, select_sizes
from reports.analysis.variant_differences import differences
from reports.analysis.verdicts import VERDICT_NOTE
from reports.equal_latency import measure_sizes
from reports.layout.page import Section, write_page
from reports.layout.tables import (
    UNRELIABLE_MARK,
    UNRELIABLE_MEANING,
    Table,
    format_difference,
    format_ms,
    format_samples,
    pivot_by_budget,
)
from reports.published import published
from rlbench.benchmark.results import MissingRowsError

__all__ = ["write"]

TIMES = ("plan_ms", "denoise_ms", "inference_ms")
LATENCY = "equal time"


def write(
    results: pd.DataFrame,
    folder: Path,
    name: str = "network-study",
    seed: int = 0,
    draws: int = BOOTSTRAP_SAMPLES,
) -> list[Path]:
    """Write `name`.md, .csv and .tex over the rows of `SIZES` that the results have.

    Rows METHOD@LABEL are compared where there are no others; the title then names the label. Raises
    MissingRowsError without scores of ours/latent and of another size on one device.
    """
    chosen, label = select_sizes(results)
    sections = []
    for device, rows in split_by_device(chosen).items():
        check_comparable(rows)
        scores = Scores(rows, device=device)
        measured = set(scores.measured["method"])
        if BASE in measured and len(measured) > 1:
            sections.append(_section(scores, seed, draws))
    if not sections:
        raise MissingRowsError(f"no device has scores of {BASE} and of another size")
    title = "Network study" + (f", rows @{label}" if label else "")
    return write_page(folder, name, title, chosen, sections)


def _section(scores: Scores, seed: int, draws: int) -> Section:
    others = sorted(set(scores.measured["method"]) - {BASE})
    gaps = differences(scores, BASE, others, seed, draws).assign(table="equal samples")
    latencies = _nearest_latencies(measure_sizes(scores, seed, draws))
    records = correct_by_holm(pd.concat([gaps, latencies]))
    gaps, latencies = (records[records["table"] == name] for name in ("equal samples", LATENCY))
    order = [row for row in SIZES if row in set(scores.measured["method"])]
    tables = [_score_table(scores, gaps, order), _time_table(scores, order)]
    if len(latencies):
        tables.append(_latency_table(latencies, order))
    lists = {
        "Differences": difference_notes(records),
        "Sizes without scores": [f"{row}: {SIZES[row]}" for row in SIZES if row not in order],
        "Not run": scores.skip_reasons,
        "Unreliable times": scores.unreliable_times,
        "Remarks": scores.remarks,
    }
    return Section(scores.device, tables, records, lists)


def _nearest_latencies(latencies: pd.DataFrame) -> pd.DataFrame:
    """Those in the frame time of the base at the budget nearest to that of the paper's base."""
    if latencies.empty:
        return latencies.assign(table=LATENCY)
    spp = nearest_budget(set(latencies["base_spp"]), published().network_study.rows[0].spp)
    return latencies[latencies["base_spp"] == spp].assign(table=LATENCY)


def _score_table(scores: Scores, gaps: pd.DataFrame, order: list[str]) -> Table:
    header, rows = pivot_by_budget(gaps, format_difference, [row for row in order if row != BASE])
    paper = published()
    base = paper.find(BASE)
    printed = [
        f"{p.psnr_db - base.psnr_db:+.1f}" if base and (p := paper.find(row[0])) else "-"
        for row in rows
    ]
    caption = (
        f"PSNR in dB ({scores.convention}) minus that of {BASE}, paired by scene, clip, frame "
        f"and seed; mean over scenes. Paper: difference in {paper.source}; for the other rows it "
        "prints a figure without numbers. Another training would differ too."
    )
    lines = [
        (f"{row[0]}: {SIZES[row[0]]}", *row[1:], text)
        for row, text in zip(rows, printed, strict=True)
    ]
    head = ("row", *header[1:], f"paper, {paper.spp:g} spp")
    return Table("Equal samples", caption, head, tuple(lines), VERDICT_NOTE)


def _time_table(scores: Scores, order: list[str]) -> Table:
    study, means = published().network_study, scores.overall
    timed = means[means["inference_ms"].notna()]
    spp = nearest_budget(set((timed if len(timed) else means)["target_spp"]), study.rows[0].spp)
    at = means[means["target_spp"] == spp].set_index("method")
    first: dict[str, Any] = dict(at.loc[BASE]) if BASE in at.index else {}
    lines = []
    for row in order:
        here: dict[str, Any] = dict(at.loc[row]) if row in at.index else {}
        mark = bool(here.get("unreliable"))
        own = [format_ms(here.get(part, float("nan")), mark) for part in TIMES]
        ratio = here.get("inference_ms", float("nan")) / first.get("inference_ms", float("nan"))
        lines.append((row, *own, _format_ratio(ratio), *_printed_times(row)))
    caption = (
        f"Inference in ms at {spp:g} spp on {scores.device_name}, mean over scenes, whose networks "
        "are timed on one clip of each size; no interval over scenes. Plan: reprojection and "
        "sampler; denoise: encoder and denoiser; inference: both and allocation; ratio: to "
        f"{BASE}. Paper: {study.source.partition(':')[0]}, {published().title}. "
        f"{UNRELIABLE_MARK}: {UNRELIABLE_MEANING}."
    )
    head = ("row", "plan", "denoise", "inference", "ratio")
    paper = ("paper: sampler", "encoder + denoiser", "inference", "ratio")
    return Table("Inference", caption, (*head, *paper), tuple(lines))


def _printed_times(row: str) -> tuple[str, ...]:
    """Sampler, encoder with denoiser, inference and ratio as published; Table 1 has a total."""
    study, table = published().network_study, published().find(row)
    base = study.rows[0].total_ms
    if times := study.find(row):
        parts = (times.sampler_ms, times.encoder_ms + times.denoiser_ms, times.total_ms)
        return (*(f"{part:.1f}" for part in parts), _format_ratio(times.total_ms / base))
    if table:
        return "-", "-", f"{table.inference_ms:.1f}", _format_ratio(table.inference_ms / base)
    return ("-",) * 4


def _latency_table(latencies: pd.DataFrame, order: list[str]) -> Table:
    study = published().network_study
    at = latencies.set_index("method")
    lines = []
    for row in (row for row in order if row in at.index):
        found: dict[Any, Any] = dict(at.loc[row])
        is_fit = found["spp"] == found["spp"]
        gap = format_difference(found) if is_fit and row != BASE else "-"
        printed = study.find(row)
        lines.append(
            (
                row,
                format_samples(found),
                _format_ratio(found["share"]),
                f"{found['value']:.2f}" if is_fit else "-",
                gap,
                f"{printed.spp:.2f}" if printed else "-",
                _format_ratio(found["paper_share"]),
            )
        )
    caption = (
        f"In the frame time of {BASE} at {at['base_spp'].iloc[0]:g} spp, "
        f"{at['deadline_ms'].iloc[0]:.1f} ms: the best budget of each row that fits, between the "
        "measured ones. After `>=` no larger was measured. Paper: spp in "
        f"{study.frame_ms:g} ms on {study.scene}, at {study.sample_ms:g} ms a sample. Ratios are "
        "to the base."
    )
    head = ("row", "spp", "ratio", "PSNR [dB]", f"minus {BASE}", "paper: spp", "ratio")
    return Table("Equal time", caption, head, tuple(lines))


def _format_ratio(ratio: float) -> str:
    return f"{ratio:.2f}" if ratio == ratio else "-"
