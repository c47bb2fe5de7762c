"""What a run found, for people and for scripts: mean scores and times by row, and remarks."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from rlbench.benchmark import latency, results
from rlbench.benchmark.resolve import resolve_method
from rlbench.benchmark.run_plan import RunPlan
from rlbench.benchmark.run_verdict import RunVerdict, judge_run
from rlbench.benchmark.runner import RunSummary

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["RunOutcome", "ScoreRow", "read_outcome"]

HEADLINE = ("psnr", "psnr_debiased")
TIMES = ("inference_ms", "frame_ms")


@dataclass(frozen=True)
class ScoreRow:
    """Means over the clips of one method at one budget; None where there is no number."""

    method: str  # name of the rows, METHOD@LABEL
    spp: float  # requested samples per pixel
    clips: int  # number of clips with a score
    psnr: float | None  # dB
    psnr_debiased: float | None  # dB, without the noise of the reference
    inference_ms: float | None
    frame_ms: float | None  # inference, G-buffer and samples
    unreliable: tuple[str, ...] = ()  # the times that a busy machine spoiled


@dataclass(frozen=True)
class RunOutcome:
    """The end of a run."""

    folder: Path  # of the results
    summary: RunSummary
    clips: int  # number of clips of the plan
    scores: list[ScoreRow]
    missing: list[str]  # why clips have no score, no inference time or no sample time
    remarks: list[str]  # unreliable times, and what to know of scores
    verdict: RunVerdict


def read_outcome(
    plan: RunPlan, summary: RunSummary, folder: Path, row_names: Iterable[str] = ()
) -> RunOutcome:
    """The outcome of a run of `plan`, from the rows that the results in `folder` have of it.

    `row_names` are the methods' names in the results, where they are not those of the plan.
    """
    rows = results.read(folder)
    names = list(row_names) or [resolve_method(plan, name).row_name for name in plan.methods]
    clips = [clip.header.name for clip in plan.clips]
    rows = rows[rows["method"].isin(names) & rows["clip"].isin(clips)]
    rows = rows[rows["target_spp"].isin(plan.target_spp) & rows["seed"].isin(plan.seeds)]
    rows = rows[rows["device"] == latency.device_name(plan.device)]
    return RunOutcome(
        folder=folder,
        summary=summary,
        clips=len(clips),
        scores=_score_rows(rows),
        missing=_missing_numbers(rows),
        remarks=_remarks(rows),
        verdict=judge_run(summary, rows),
    )


def _score_rows(rows: pd.DataFrame) -> list[ScoreRow]:
    """Means over clips, by method and budget."""
    table = []
    for _, group in rows.groupby(["method", "target_spp"]):
        method, spp = group["method"].iloc[0], group["target_spp"].iloc[0]
        means = group.groupby("metric")["value"].mean()
        psnr, debiased, inference_ms, frame_ms = (
            _number(means.get(name)) for name in (*HEADLINE, *TIMES)
        )
        doubted = set(group.loc[_is_unreliable(group), "metric"])
        scored = group.loc[(group["metric"] == "psnr") & group["value"].notna(), "clip"].nunique()
        unreliable = tuple(name for name in TIMES if name in doubted)
        numbers = scored, psnr, debiased, inference_ms, frame_ms
        table.append(ScoreRow(method, float(spp), *numbers, unreliable))
    return table


def _missing_numbers(rows: pd.DataFrame) -> list[str]:
    """Why clips have no score, no inference time or no sample time, by method and reason."""
    missing = rows[(rows["frame"] == results.WHOLE_CLIP) & rows["value"].isna()]
    missing = missing[missing["metric"].isin(["psnr", "inference_ms", "sample_ms"])]
    return [
        f"{method}: no {metric} on {', '.join(sorted(set(group['clip'])))}: {note}"
        for (method, metric, note), group in missing.groupby(["method", "metric", "note"])
    ]


def _remarks(rows: pd.DataFrame) -> list[str]:
    """How many rows have unreliable times and why, and remarks on scores."""
    frames = rows[(rows["metric"] == "frame_ms") & _is_unreliable(rows)]
    found = []
    if count := len(frames[["method", "target_spp"]].drop_duplicates()):
        reason = frames["note"].iloc[0].removeprefix(results.UNRELIABLE).strip()
        found.append(
            f"{count} rows have unreliable times, marked ?: {reason}. When the machine is idle, "
            "repeat the command with --retime"
        )
    scored = rows[(rows["metric"] == "psnr") & rows["value"].notna() & (rows["note"] != "")]
    pairs = scored[["method", "note"]].drop_duplicates().sort_values(["method", "note"])
    return found + [f"{method}: {note}" for method, note in pairs.itertuples(index=False)]


def _is_unreliable(rows: pd.DataFrame) -> pd.Series[bool]:
    return rows["note"].str.startswith(results.UNRELIABLE)


def _number(value: float | None) -> float | None:
    return None if value is None or value != value else float(value)
