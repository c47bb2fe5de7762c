"""Equal time and equal error: crossovers, scores in a deadline, spp and time to the same error."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from reports.analysis.aggregate import Scores
from reports.analysis.comparability import check_comparable, split_by_device
from reports.analysis.crossovers import crossovers
from reports.analysis.curves import Curve, curves_of, measured_sample_ms, methods_without_curve
from reports.analysis.equal_error import at_equal_error
from reports.analysis.equal_time import at_deadlines, nice_deadlines, with_half_the_samples
from reports.analysis.intervals import BOOTSTRAP_SAMPLES
from reports.analysis.misses import with_misses
from reports.analysis.multiplicity import correct_by_holm, difference_notes
from reports.layout.equal_error_tables import effective_table, error_tables, level_table
from reports.layout.equal_time_tables import crossover_table, deadline_table, half_table
from reports.layout.page import Section, write_page
from rlbench.benchmark.results import MissingRowsError

__all__ = ["write"]

BASE = "ours"  # whose errors the others are to reach; the best method if it was not measured

LEVELS = 5  # whole dB in the table of times to a given PSNR

REFERENCE = "mean"  # whose spp measure the others: no denoiser

METRIC = "psnr"


def write(
    results: pd.DataFrame,
    folder: Path,
    name: str = "equal_time",
    base: str = BASE,
    reference: str = REFERENCE,
    seed: int = 0,
    draws: int = BOOTSTRAP_SAMPLES,
) -> list[Path]:
    """Write `name`.md, .csv and .tex with a section for each device, and return the files.

    Samples cost what they cost in the results. `base` is the method whose errors the others are to
    reach, `reference` the one in whose samples all are counted (effective spp). Raises
    MissingRowsError if no method has scores and times on every scene.
    """
    sections = []
    for device, rows in split_by_device(results).items():
        check_comparable(rows)
        scores = Scores(rows, METRIC, device)
        curves, sample_ms = curves_of(scores), measured_sample_ms(scores)
        if not curves or np.isnan(sample_ms):
            continue
        sections.append(_section(scores, curves, sample_ms, (base, reference), seed, draws))
    if not sections:
        raise MissingRowsError(
            f"equal times need {METRIC}, plan_ms, denoise_ms and sample_ms of a method on every "
            "scene, and no device has them; measure them with rlbench run"
        )
    return write_page(folder, name, "Equal time and equal error", results, sections)


def _section(
    scores: Scores,
    curves: list[Curve],
    sample_ms: float,
    names: tuple[str, str],
    seed: int,
    draws: int,
) -> Section:
    by_name = {curve.method: curve for curve in curves}
    best = max(curves, key=lambda curve: curve.value_at(curve.spp).max())
    base, reference = by_name.get(names[0], best), by_name.get(names[1])
    rivals = [curve for curve in curves if curve is not base]
    deadlines = nice_deadlines(curves, sample_ms)
    late_curves = curves_of(Scores(with_misses(scores.rows), METRIC, scores.device))
    compared = {
        "half the samples": with_half_the_samples(curves, base, sample_ms, "dB", seed, draws),
        "equal time": at_deadlines(curves, sample_ms, deadlines, "dB", False, seed, draws),
        "deadline": at_deadlines(late_curves, sample_ms, deadlines, "dB", True, seed, draws),
    }
    differences = correct_by_holm(pd.concat([v.assign(table=k) for k, v in compared.items()]))
    parts = {title: differences[differences["table"] == title] for title in compared} | {
        "equal error": at_equal_error(rivals, _errors_of(base), sample_ms, seed),
        "given error": at_equal_error(curves, _round_scores(curves), sample_ms, seed),
        "effective spp": _effective_spp(curves, reference, sample_ms, seed),
        "crossover": crossovers(curves, sample_ms, seed),
    }
    tables = [
        half_table(parts["half the samples"], base),
        deadline_table(parts["equal time"], scores, sample_ms, late=False),
        deadline_table(parts["deadline"], scores, sample_ms, late=True),
        *error_tables(parts["equal error"], base, sample_ms, by_name),
        level_table(parts["given error"], sample_ms, by_name),
        effective_table(parts["effective spp"], reference),
        crossover_table(parts["crossover"]),
    ]
    records = pd.concat([part.assign(table=title) for title, part in parts.items() if len(part)])
    lists = {
        "Differences": difference_notes(differences),
        "Without a curve": methods_without_curve(scores, curves),
        "Left out of the means": scores.incomplete_groups,
        "Not run": scores.skip_reasons,
        "Remarks": scores.remarks,
    }
    return Section(scores.device, [table for table in tables if table.rows], records, lists)


def _errors_of(base: Curve) -> dict[float, np.ndarray]:
    return dict(zip(base.spp.tolist(), base.units, strict=True))


def _round_scores(curves: list[Curve]) -> dict[float, np.ndarray]:
    """Whole dB from the best score of the weakest curve to that of the best, at most LEVELS."""
    tops = [curve.value_at(curve.spp).max() for curve in curves]
    high = int(np.floor(max(tops)))
    levels = range(max(int(np.ceil(min(tops))), high - LEVELS + 1), high + 1)
    return {float(level): np.full(curves[0].units.shape[1], float(level)) for level in levels}


def _effective_spp(
    curves: list[Curve], reference: Curve | None, sample_ms: float, seed: int
) -> pd.DataFrame:
    """The spp at which `reference` has the error of each method, at each of its budgets."""
    parts = [
        at_equal_error([reference], _errors_of(curve), sample_ms, seed).assign(method=curve.method)
        for curve in curves
        if reference and curve is not reference
    ]
    return pd.concat(parts) if parts else pd.DataFrame()
