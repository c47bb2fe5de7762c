"""What a run found, for people and for scripts: scores, times, remarks, and a verdict.

A run ends here. The verdict says which cells failed, and which have images that are not finite.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from rlbench.benchmark import latency, results
from rlbench.benchmark.cell_key import CellKey
from rlbench.benchmark.run_plan import RunPlan, row_name
from rlbench.benchmark.runner import RunSummary

if TYPE_CHECKING:
    import pandas as pd

HEADLINE = ("psnr", "psnr_debiased")
TIMES = ("inference_ms", "frame_ms")
NONFINITE = "nonfinite"  # metric that counts pixels with a NaN or infinite channel
MAX_NAMES = 3  # cells that a sentence names


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
    inference_uncertainty: float = 0.0  # see `results.uncertainty`
    frame_uncertainty: float = 0.0


@dataclass(frozen=True)
class RunOutcome:
    """The end of a run."""

    folder: Path  # of the results
    summary: RunSummary
    clips: int  # number of clips of the plan
    scores: list[ScoreRow]
    missing: list[str]  # why clips have no score, no inference time or no sample time
    remarks: list[str]  # uncertain times, and what to know of scores
    verdict: RunVerdict


def read_outcome(
    plan: RunPlan, summary: RunSummary, folder: Path, row_names: Iterable[str] = ()
) -> RunOutcome:
    """The outcome of a run of `plan`, from the rows that the results in `folder` have of it.

    `row_names` are the methods' names in the results, where they are not those of the plan.
    """
    rows = results.read(folder)
    names = list(row_names) or [row_name(plan, name) for name in plan.methods]
    clips = [clip.header.name for clip in plan.clips]
    rows = rows[rows["method"].isin(names) & rows["clip"].isin(clips)]
    rows = rows[rows["target_spp"].isin(plan.spp) & rows["seed"].isin(plan.seeds)]
    rows = rows[rows["device"] == latency.device_name(plan.device)]
    return RunOutcome(
        folder=folder,
        summary=summary,
        clips=len(clips),
        scores=_score_rows(rows),
        missing=_missing_numbers(rows),
        remarks=_remarks(rows, folder),
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
        doubts = [
            results.uncertainty(*means.reindex(results.interval_columns(name)))
            for name in ("inference", "frame")
        ]
        scored = group.loc[(group["metric"] == "psnr") & group["value"].notna(), "clip"].nunique()
        numbers = scored, psnr, debiased, inference_ms, frame_ms
        table.append(ScoreRow(method, float(spp), *numbers, *doubts))
    return table


def _missing_numbers(rows: pd.DataFrame) -> list[str]:
    """Why clips have no score, no inference time or no sample time, by method and reason."""
    missing = rows[(rows["frame"] == results.WHOLE_CLIP) & rows["value"].isna()]
    missing = missing[missing["metric"].isin(["psnr", "inference_ms", "sample_ms"])]
    return [
        f"{method}: no {metric} on {', '.join(sorted(set(group['clip'])))}: {note}"
        for (method, metric, note), group in missing.groupby(["method", "metric", "note"])
    ]


def _remarks(rows: pd.DataFrame, folder: Path) -> list[str]:
    """How many rows have uncertain times and why, and remarks on scores."""
    scored = rows[(rows["metric"] == "psnr") & rows["value"].notna() & (rows["note"] != "")]
    pairs = scored[["method", "note"]].drop_duplicates().sort_values(["method", "note"])
    notes = [f"{method}: {note}" for method, note in pairs.itertuples(index=False)]
    return [*uncertainty_remark(rows, folder), *notes]


def uncertainty_remark(rows: pd.DataFrame, folder: Path) -> list[str]:
    """How many rows have uncertain times, why most have, and the command that mends them."""
    uncertain = rows[rows["metric"].isin(TIMES) & rows["note"].str.startswith(results.UNCERTAIN)]
    if not (count := len(uncertain[["method", "target_spp"]].drop_duplicates())):
        return []
    reason = uncertain["note"].mode().iloc[0].removeprefix(results.UNCERTAIN).strip()
    return [
        f"{count} row{'s have' if count > 1 else ' has'} uncertain times, marked ±: {reason}. "
        "When the machine is quiet, measure these again: rlbench run --config "
        f"{folder / 'run.toml'} --out {folder} --times uncertain"
    ]


def _number(value: float | None) -> float | None:
    return None if value is None or value != value else float(value)


class RunWarning(UserWarning):
    """A run whose rows lack numbers that were requested; issued by `rlbench.run`."""


@dataclass(frozen=True)
class NonFinite:
    """A cell with NaN or infinite values, counted in the frame that has most of them."""

    cell: CellKey
    frame: int
    pixels: int  # with a channel that is not finite
    of_pixels: int

    def __str__(self) -> str:
        """The cell and the number of pixels, for messages.

        >>> print(NonFinite(CellKey("nan", "city", 1.0, 0, "EPYC"), 3, 16, 36864))
        nan: 16 of 36864 pixels not finite in frame 3 of city at 1 spp, seed 0
        """
        key, total = self.cell, f" of {self.of_pixels}" * bool(self.of_pixels)
        return (
            f"{key.method}: {self.pixels}{total} pixels not finite in frame {self.frame} of "
            f"{key.clip} at {key.target_spp:g} spp, seed {key.seed}"
        )


@dataclass(frozen=True)
class RunVerdict:
    """Whether a run measured what it could. A cell that a method does not support is not a failure.

    >>> print(RunVerdict((), (), has_numbers=True))
    passed: no cell failed, all images are finite
    """

    failed: tuple[CellKey, ...]  # cells that an error stopped
    nonfinite: tuple[NonFinite, ...]  # cells with an image that has NaN or infinite values
    has_numbers: bool

    @property
    def has_passed(self) -> bool:
        """True if there is a number, no failed cell, and no image that is not finite."""
        return self.has_numbers and not self.failed and not self.nonfinite

    def __str__(self) -> str:
        """The verdict in one line, with the first cells of each kind."""
        if self.has_passed:
            return "passed: no cell failed, all images are finite"
        faults = {
            "stopped by an error": self.failed,
            "with images that are not finite": tuple(each.cell for each in self.nonfinite),
        }
        parts = [
            f"{_count(cells)} {what} ({_names(cells)})" for what, cells in faults.items() if cells
        ]
        return f"FAILED: {'; '.join(parts) or 'no cell has a number'}"


def judge_run(summary: RunSummary, rows: pd.DataFrame) -> RunVerdict:
    """The verdict on a run with these counts and with these rows, measured now or before."""
    bad = rows[(rows["metric"] == NONFINITE) & (rows["value"] > 0)]
    columns = ["method", "clip", "target_spp", "seed", "device"]
    worst = bad.sort_values(["value", "frame"], ascending=[False, True], kind="stable")
    worst = worst.drop_duplicates(columns).sort_index()
    counted = worst[[*columns, "frame", "value", "size"]].itertuples(index=False, name=None)
    nonfinite = tuple(
        NonFinite(CellKey(*cell), int(frame), int(pixels), _pixels(size))
        for *cell, frame, pixels, size in counted
    )
    return RunVerdict(summary.failures, nonfinite, bool(rows["value"].notna().any()))


def _pixels(size: str) -> int:
    """The number of pixels of a size such as 192x192; 0 for an empty one."""
    return math.prod(map(int, size.split("x"))) if size else 0


def _count(cells: Sequence[CellKey]) -> str:
    return f"{len(cells)} cell{'s' if len(cells) > 1 else ''}"


def _names(cells: Sequence[CellKey]) -> str:
    more = f", and {len(cells) - MAX_NAMES} more" if len(cells) > MAX_NAMES else ""
    return ", ".join(map(str, cells[:MAX_NAMES])) + more
