"""Which method at which budget gives the least error in a frame time: the answer as data and text.

The command `rlbench decide` prints it.
"""

from __future__ import annotations

from collections.abc import Sequence

import pandas as pd

from reports.analysis import notes
from reports.analysis.aggregate import Scores
from reports.analysis.comparability import ReportError, check_comparable, select_device
from reports.analysis.curves import (
    Curve,
    curves_of,
    measured_sample_ms,
    methods_without_curve,
)
from reports.analysis.decision import Decision, break_evens, candidates
from reports.analysis.intervals import BOOTSTRAP_SAMPLES
from reports.layout.decision_text import decision_text

__all__ = ["decide", "decision_text"]

TIMES = ("plan_ms", "allocate_ms", "denoise_ms")


def decide(
    results: pd.DataFrame,
    sample_ms: float,
    frame_ms: float,
    metric: str = "psnr",
    device: str = "",
    left_out: Sequence[str] = (),
    seed: int = 0,
    draws: int = BOOTSTRAP_SAMPLES,
) -> Decision:
    """The method with the best expected score among those that fit `frame_ms`, and its rivals.

    `sample_ms` is the time of one path sample for each pixel; the time of a frame is plan +
    allocate + denoise (from the results) + samples x `sample_ms`, mean over scenes. `device` names
    the device whose times are used, where the results have several. `left_out` are sentences about
    rows that were not considered. Raises ReportError if no method fits or has times, or if rows
    cannot be compared.
    """
    rows, device = select_device(results, device)
    check_comparable(rows)
    scores = Scores(rows, metric, device)
    _check_metric(scores)
    curves = curves_of(scores)
    if not curves:
        raise ReportError(
            f"no method has {metric} and times on every scene; found: "
            f"{'; '.join(methods_without_curve(scores, []))}. Measure with rlbench run"
        )
    ranked = candidates(curves, sample_ms, frame_ms, scores.column_text("unit"), seed, draws)
    if not ranked:
        raise _nothing_fits(curves, sample_ms, frame_ms)
    timed = rows[rows["metric"].isin(TIMES) & rows["method"].isin([c.method for c in curves])]
    return Decision(
        sample_ms=sample_ms,
        frame_ms=frame_ms,
        metric=metric,
        unit=scores.column_text("unit"),
        convention=scores.convention,
        direction=scores.direction,
        candidates=ranked,
        changes=tuple(break_evens(curves, sample_ms, frame_ms)),
        scenes=tuple(sorted(set(scores.scene_means["scene"]))),
        inference_device=device,
        image_sizes=tuple(sorted(set(timed["size"]) - {""})),
        measured_sample_ms=measured_sample_ms(scores),
        measured_sample_source=scores.cost_source,
        notes=(*left_out, *methods_without_curve(scores, curves), *notes.remarks(timed)),
    )


def _check_metric(scores: Scores) -> None:
    if scores.measured.empty or scores.direction not in ("higher", "lower"):
        ranked = scores.rows[scores.rows["value"].notna() & (scores.rows["direction"] != "")]
        names = sorted(set(ranked.loc[ranked["unit"] != "ms", "metric"])) or ["none"]
        raise ReportError(
            f"metric '{scores.metric}' was requested, and the results have no values of it that "
            f"rank methods; metrics that do: {', '.join(names)}"
        )


def _nothing_fits(curves: Sequence[Curve], sample_ms: float, frame_ms: float) -> ReportError:
    times = {
        (float(time), curve.method, float(spp)): curve
        for curve in curves
        for spp, time in zip(curve.spp, curve.frame_ms(sample_ms), strict=True)
    }
    needed, method, spp = min(times)
    return ReportError(
        f"no method fits {frame_ms:g} ms at {sample_ms:g} ms a sample; the cheapest, {method} at "
        f"{spp:g} spp, needs {needed:.3g} ms. Raise --frame-ms, "
        "or measure smaller budgets or smaller images: rlbench run --spp 0.25"
    )
