"""Equal time and equal error: crossovers, scores in a deadline, spp and time to the same error."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from reports.analysis.aggregate import Scores
from reports.analysis.comparability import check_comparable, split_by_device
from reports.analysis.curves import Curve, curves_of, measured_sample_ms, methods_without_curve
from reports.analysis.equal import (
    SPP_COLUMNS,
    TIME_COLUMNS,
    at_deadlines,
    at_equal_error,
    crossovers,
    nice_deadlines,
    with_half_the_samples,
)
from reports.analysis.intervals import BOOTSTRAP_SAMPLES, INTERVAL_NOTE
from reports.analysis.method_names import family_of
from reports.layout.page import Section, write_page
from reports.layout.tables import Bold, Table, format_difference
from reports.published import published
from rlbench.benchmark.results import MissingRowsError

__all__ = ["write"]

BASE = "ours"  # whose errors the others are to reach; the best method if it was not measured
LEVELS = 5  # whole dB in the table of times to a given PSNR
REFERENCE = "mean"  # whose spp measure the others: no denoiser
METRIC = "psnr"
Record = Mapping[Hashable, Any]
INVERTED = (
    "Brackets: where the paired 95 % interval of the difference includes zero. `<`: already at the "
    "smallest measured budget; `>`: not by the largest."
)
VERDICTS = "Tie: the interval lies within +-0.1 dB. Not resolved: it includes zero."


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
    parts = {
        "half the samples": with_half_the_samples(curves, base, sample_ms, "dB", seed, draws),
        "equal time": at_deadlines(curves, sample_ms, deadlines, "dB", False, seed, draws),
        "deadline": at_deadlines(curves, sample_ms, deadlines, "dB", True, seed, draws),
        "equal error": at_equal_error(rivals, _errors_of(base), sample_ms, seed),
        "given error": at_equal_error(curves, _round_scores(curves), sample_ms, seed),
        "effective spp": _effective_spp(curves, reference, sample_ms, seed),
        "crossover": crossovers(curves, sample_ms, seed),
    }
    tables = [
        _half_table(parts["half the samples"], base),
        _deadline_table(parts["equal time"], scores, sample_ms, late=False),
        _deadline_table(parts["deadline"], scores, sample_ms, late=True),
        *_error_tables(parts["equal error"], base, sample_ms, by_name),
        _level_table(parts["given error"], sample_ms, by_name),
        _effective_table(parts["effective spp"], reference),
        _crossover_table(parts["crossover"]),
    ]
    records = pd.concat([part.assign(table=title) for title, part in parts.items() if len(part)])
    lists = {
        "Without a curve": methods_without_curve(scores, curves),
        "Left out of the means": scores.incomplete_groups,
        "Not run": scores.skip_reasons,
        "Remarks": scores.remarks,
    }
    return Section(scores.device, [table for table in tables if table.rows], records, lists)


def _half_table(records: pd.DataFrame, base: Curve) -> Table:
    rows = [
        (
            f"{row['method']} at {row['spp']:g} spp",
            f"{row['rival']} at {row['rival_spp']:g} spp",
            _with_verdict(row),
            f"{row['frame_ms']:.1f}",
            f"{row['rival_ms']:.1f}",
            f"{row['speedup']:.2f}",
        )
        for row in records.to_dict("records")
    ]
    if rows and (printed := _published_row(base.method)):
        rows.append(printed)
    caption = (
        f"{base.method} against the best method of another family with twice its samples. PSNR in "
        f"dB, paired by scene; brackets: {INTERVAL_NOTE}, bold if it excludes zero. {VERDICTS} "
        "Faster: frame time of the rival / that of the method. "
        f"Last row, where it is there: the numbers of {published().title}, at its cost of a sample."
    )
    header = ("method", "best rival", "difference", "ms", "rival ms", "faster")
    return Table("Half the samples", caption, header, tuple(rows))


def _published_row(base: str) -> tuple[str, ...] | None:
    """The headline of the paper in the same columns; None for a method that it does not have."""
    paper = published()
    half = next((p for p in paper.points() if p.row == base and 2 * p.spp == paper.spp), None)
    method = paper.find(base)
    if half is None or method is None:
        return None
    rivals = [row for row in paper.table if family_of(row.row) != family_of(base)]
    rival = max(rivals, key=lambda row: row.psnr_db)
    frame_ms = method.inference_ms + half.spp * paper.sample_ms
    rival_ms = rival.inference_ms + paper.spp * paper.sample_ms
    return (
        f"paper: {method.name} at {half.spp:g} spp",
        f"{rival.name} at {paper.spp:g} spp",
        f"{half.psnr_db - rival.psnr_db:+.1f}",
        f"{frame_ms:.1f}",
        f"{rival_ms:.1f}",
        f"{rival_ms / frame_ms:.2f}",
    )


def _deadline_table(records: pd.DataFrame, scores: Scores, sample_ms: float, late: bool) -> Table:
    def cell(row: Record) -> str:
        text = f"{row['value']:.2f}"
        if row["best"]:
            return Bold(text)
        return f"{text} ({_plain_difference(row)}) {row['verdict']}".strip()

    percentile = "p95" if late else "p50"
    caption = (
        f"PSNR in dB ({scores.convention}), mean over scenes, of each method at its best spp whose "
        f"frame time is within the time at the top: plan + denoise ({percentile}, on "
        f"{scores.device_name}) + samples x {sample_ms:.3g} ms "
        f"({scores.cost_source or 'an unnamed source'}), mean over scenes. "
        "Between measured budgets linear in log spp; none is extrapolated. Parentheses: paired "
        f"difference to the best and its {INTERVAL_NOTE}. {VERDICTS} "
    )
    if late:
        caption += (
            "Frames whose plan + denoise takes longer than its p95, one in 20, are late and show "
            "the last image again; the error of that image is not part of the PSNR here."
        )
    title = "Quality at a deadline that 95 % of frames meet" if late else "Equal time"
    return _by_column(title, caption, records, "deadline_ms", lambda ms: f"{ms:g} ms", cell)


def _errors_of(base: Curve) -> dict[float, np.ndarray]:
    return dict(zip(base.spp.tolist(), base.units, strict=True))


def _round_scores(curves: list[Curve]) -> dict[float, np.ndarray]:
    """Whole dB from the best score of the weakest curve to that of the best, at most LEVELS."""
    tops = [curve.value_at(curve.spp).max() for curve in curves]
    high = int(np.floor(max(tops)))
    levels = range(max(int(np.ceil(min(tops))), high - LEVELS + 1), high + 1)
    return {float(level): np.full(curves[0].units.shape[1], float(level)) for level in levels}


def _error_tables(
    records: pd.DataFrame, base: Curve, sample_ms: float, curves: Mapping[str, Curve]
) -> list[Table]:
    times = dict(zip(base.spp.tolist(), base.frame_ms(sample_ms).tolist(), strict=True))
    return [
        _by_column(
            f"Samples to the error of {base.method}",
            f"spp at which each method has the PSNR that {base.method} has at the spp on top. "
            + INVERTED,
            records,
            "target",
            lambda spp: f"{spp:g} spp",
            lambda row: _spp_cell(row, curves[row["method"]]),
        ),
        _by_column(
            f"Time to the error of {base.method}",
            f"Frame time in ms at which each method has the PSNR that {base.method} has at the "
            f"spp and in the time on top. {INVERTED}",
            records,
            "target",
            lambda spp: f"{spp:g} spp, {times[spp]:.1f} ms",
            lambda row: _time_cell(row, curves[row["method"]], sample_ms),
        ),
    ]


def _level_table(records: pd.DataFrame, sample_ms: float, curves: Mapping[str, Curve]) -> Table:
    caption = (
        "Frame time in ms at which each method has the mean PSNR on top. Brackets: where the 95 % "
        "interval of the mean over scenes includes it, which is wide, since scenes differ. `<`: "
        "already at the smallest measured budget; `>`: not by the largest."
    )
    return _by_column(
        "Time to a given PSNR",
        caption,
        records,
        "target",
        lambda level: f"{level:g} dB",
        lambda row: _time_cell(row, curves[row["method"]], sample_ms),
    )


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


def _effective_table(records: pd.DataFrame, reference: Curve | None) -> Table:
    if reference is None:
        return Table("Effective spp", "", ("method",), ())
    caption = (
        f"spp at which {reference.method} has the PSNR of the method at the spp on top: how many "
        f"samples the method is worth. {INVERTED}"
    )
    return _by_column(
        f"Effective spp, in samples of {reference.method}",
        caption,
        records,
        "target",
        lambda spp: f"{spp:g} spp",
        lambda row: _spp_cell(row, reference),
    )


def _crossover_table(records: pd.DataFrame) -> Table:
    rows = tuple(
        (
            f"{row['method']} passes {row['other']}",
            f"{row['at_ms']:.1f}",
            _unresolved(row),
            f"{row['value']:.2f}",
            f"{row['spp']:.3g}",
            f"{row['other_spp']:.3g}",
        )
        for row in records.to_dict("records")
    )
    caption = (
        "Frame time from which one method of a pair has the higher PSNR, both at their best spp "
        "within that time; a pair without a row has one leader wherever both fit. Not resolved: "
        "the times around it at which the paired 95 % interval of their difference includes zero."
    )
    return Table(
        "Crossovers",
        caption,
        ("pair", "ms", "not resolved", "PSNR", "spp", "spp of the other"),
        rows,
    )


def _unresolved(row: Record) -> str:
    low, high = row["low_ms"], row["high_ms"]
    if low != low:
        return "-"
    start, end = ("" if x in (0, np.inf) else f"{x:.0f}" for x in (low, high))
    return f"{start} to {end}".strip() if start or end else "everywhere"


def _by_column(
    title: str,
    caption: str,
    records: pd.DataFrame,
    column: str,
    heading: Callable[[float], str],
    cell: Callable[[Record], str],
) -> Table:
    """A row per method and a column per value of `column`."""
    if records.empty:
        return Table(title, caption, ("method",), ())
    values = sorted(set(records[column]))
    cells = {(row["method"], row[column]): cell(row) for row in records.to_dict("records")}
    rows = tuple(
        (method, *(cells.get((method, value), "-") for value in values))
        for method in sorted(set(records["method"]))
    )
    return Table(title, caption, ("method", *map(heading, values)), rows)


def _plain_difference(row: Record) -> str:
    return str(format_difference(row["difference"], row["low"], row["high"]))


def _with_verdict(row: Record) -> str:
    text = format_difference(row["difference"], row["low"], row["high"])
    return f"{text} {row['verdict']}" if row["verdict"] else text


def _spp_cell(row: Record, curve: Curve) -> str:
    positive = curve.spp[curve.spp > 0]
    ends = (f"{positive[0]:g}", f"{positive[-1]:g}")
    return _with_ends(*(_bounded(row[name], f"{row[name]:.3g}", ends) for name in SPP_COLUMNS))


def _time_cell(row: Record, curve: Curve, sample_ms: float) -> str:
    times = curve.frame_ms(sample_ms)[curve.spp > 0]
    ends = (f"{times[0]:.1f}", f"{times[-1]:.1f}")
    pairs = zip(SPP_COLUMNS, TIME_COLUMNS, strict=True)
    return _with_ends(*(_bounded(row[spp], f"{row[ms]:.1f}", ends) for spp, ms in pairs))


def _bounded(spp: float, text: str, ends: tuple[str, str]) -> str:
    """The text, or a bound where the budget lies outside of the measured ones; - if unknown."""
    if spp != spp:
        return "-"
    return f"<{ends[0]}" if spp == 0 else f">{ends[1]}" if spp == np.inf else text


def _with_ends(value: str, low: str, high: str) -> str:
    return value if low == high or "-" in (low, high) else f"{value} [{low}, {high}]"
