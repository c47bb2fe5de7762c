"""Equal time and equal error: crossovers, scores in a deadline, spp and time to the same error."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from reports.analysis.curves import (
    Curve,
    Numbers,
    curves_of,
    measured_sample_ms,
    methods_without_curve,
)
from reports.analysis.differences import VERDICT_NOTE, correct_by_holm, difference_notes
from reports.analysis.equal_time import (
    SPP_COLUMNS,
    TIME_COLUMNS,
    at_deadlines,
    at_equal_error,
    crossovers,
    nice_deadlines,
    with_half_the_samples,
)
from reports.analysis.rows import family_of
from reports.analysis.scores import Scores, with_misses
from reports.layout.page import Section, write_report
from reports.layout.tables import Bold, Record, Table, format_difference, pivot
from reports.published import published
from rlbench.benchmark.results import mark_uncertainty

LEVELS = 5  # whole dB in the table of times to a given PSNR
REFERENCE = "mean"  # whose spp measure the others: no denoiser
INVERTED = (
    "Brackets: where the paired 95 % interval of the difference includes zero. `<`: already at the "
    "smallest measured budget; `>`: not by the largest."
)


def write(
    results: pd.DataFrame, folder: Path, name: str = "equal_time", base: str = "ours"
) -> list[Path]:
    """Write the page, see `write_report`; samples cost what they cost in the results.

    `base` is the method whose errors the others are to reach, the best one if it was not measured.
    """
    missing = (
        "equal times need psnr, plan_ms, denoise_ms and sample_ms of a method on every "
        "scene, and no device has them; measure them with rlbench run"
    )
    title = "Equal time and equal error"
    return write_report(results, folder, name, title, lambda s: _section(s, base), missing)


def _section(scores: Scores, base_name: str) -> Section | None:
    curves, sample_ms = curves_of(scores), measured_sample_ms(scores)
    if not curves or np.isnan(sample_ms):
        return None
    by_name = {curve.method: curve for curve in curves}
    best = max(curves, key=lambda curve: curve.value_at(curve.spp).max())
    base, reference = by_name.get(base_name, best), by_name.get(REFERENCE)
    rivals = [curve for curve in curves if curve is not base]
    doubts = {c.method: mark_uncertainty(c.uncertainty(sample_ms)) for c in curves}
    deadlines = nice_deadlines(curves, sample_ms)
    late_curves = curves_of(replace(scores, rows=with_misses(scores.rows)))
    compared = {
        "half the samples": with_half_the_samples(curves, base, sample_ms),
        "equal time": at_deadlines(curves, sample_ms, deadlines),
        "deadline": at_deadlines(late_curves, sample_ms, deadlines, late=True),
    }
    differences = correct_by_holm(pd.concat([v.assign(table=k) for k, v in compared.items()]))
    parts = {title: differences[differences["table"] == title] for title in compared} | {
        "equal error": at_equal_error(rivals, _errors_of(base), sample_ms),
        "given error": at_equal_error(curves, _round_scores(curves), sample_ms),
        "effective spp": _effective_spp(curves, reference, sample_ms),
        "crossover": crossovers(curves, sample_ms),
    }
    tables = [
        _half_table(parts["half the samples"], base, doubts),
        _deadline_table(parts["equal time"], scores, sample_ms, late=False),
        _deadline_table(parts["deadline"], scores, sample_ms, late=True),
        *_error_tables(parts["equal error"], base, sample_ms, by_name),
        _level_table(parts["given error"], sample_ms, by_name),
        *([_effective_table(parts["effective spp"], reference)] if reference else []),
        _crossover_table(parts["crossover"]),
    ]
    records = pd.concat([part.assign(table=title) for title, part in parts.items() if len(part)])
    lists = {
        "Differences": difference_notes(differences),
        "Without a curve": methods_without_curve(scores, curves),
        "Uncertain times": scores.uncertain_times,
        "Left out of the means": scores.incomplete_groups,
        "Not run": scores.skip_reasons,
        "Remarks": scores.remarks,
    }
    return Section(scores.device, [table for table in tables if table.rows], records, lists)


def _errors_of(base: Curve) -> dict[float, Numbers]:
    return dict(zip(base.spp.tolist(), base.units, strict=True))


def _round_scores(curves: list[Curve]) -> dict[float, Numbers]:
    """Whole dB from the best score of the weakest curve to that of the best, at most LEVELS."""
    tops = [curve.value_at(curve.spp).max() for curve in curves]
    high = int(np.floor(max(tops)))
    levels = range(max(int(np.ceil(min(tops))), high - LEVELS + 1), high + 1)
    return {float(level): np.full(curves[0].units.shape[1], float(level)) for level in levels}


def _effective_spp(curves: list[Curve], reference: Curve | None, sample_ms: float) -> pd.DataFrame:
    """The spp at which `reference` has the error of each method, at each of its budgets."""
    parts = [
        at_equal_error([reference], _errors_of(curve), sample_ms).assign(method=curve.method)
        for curve in curves
        if reference and curve is not reference
    ]
    return pd.concat(parts) if parts else pd.DataFrame()


def _half_table(records: pd.DataFrame, base: Curve, doubts: Mapping[str, str]) -> Table:
    """`base` against the best rival with twice its samples, and the row that the paper prints."""
    rows: list[tuple[str, ...]] = [
        (
            f"{row['method']} at {row['spp']:g} spp",
            f"{row['rival']} at {row['rival_spp']:g} spp",
            format_difference(row),
            f"{row['frame_ms']:.1f}{doubts[row['method']]}",
            f"{row['rival_ms']:.1f}{doubts[row['rival']]}",
            f"{row['speedup']:.2f}",
        )
        for row in records.to_dict("records")
    ]
    if rows and (printed := _published_row(base.method)):
        rows.append(printed)
    caption = (
        f"{base.method} against the best method of another family with twice its samples. PSNR in "
        "dB, paired by scene. Faster: frame time of the rival / that of the method. "
        f"Last row, where it is there: the numbers of {published().title}, at its cost of a sample."
    )
    header = ("method", "best rival", "difference", "ms", "rival ms", "faster")
    return Table("Half the samples", caption, header, tuple(rows), VERDICT_NOTE)


def _published_row(base: str) -> tuple[str, ...] | None:
    """The headline of the paper in the same columns; None for a base of another family."""
    paper, family = published(), family_of(base)
    points = [point for point in paper.points() if family_of(point.row) == family]
    half = next((point for point in points if 2 * point.spp == paper.spp), None)
    method = paper.find(half.row) if half else None
    if half is None or method is None:
        return None
    rivals = [row for row in paper.table if family_of(row.row) != family]
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
    """The score of each method within each deadline; `late`: that 95 % of its frames meet."""

    def cell(row: Record) -> str:
        text = f"{row['value']:.2f}{_time_doubt(row['value_range'])}"
        return Bold(text) if row["best"] else f"{text} ({format_difference(row)})"

    percentile = "p95" if late else "mean of the middle half"
    caption = (
        f"PSNR in dB ({scores.convention}), mean over scenes, of each method at its best spp whose "
        f"frame time is within the time at the top: plan + allocate + denoise ({percentile}, on "
        f"{scores.device_name}) + samples x {sample_ms:.3g} ms "
        f"({scores.cost_source or 'an unnamed source'}), mean over scenes. "
        "Between measured budgets linear in log spp; none is extrapolated. Parentheses: paired "
        "difference to the best. "
    )
    caption += (
        "±: half of the range of the PSNR over the interval of an uncertain time; `?`: at its high "
        "end no measured budget fits. "
    )
    if late:
        caption += (
            "Frames whose inference takes longer than its p95, one in 20, are late and show "
            "the last image again: the PSNR is 0.95 psnr + 0.05 psnr_late."
        )
    title = "Quality at a deadline that 95 % of frames meet" if late else "Equal time"
    best_first = records.sort_values(["deadline_ms", "value"], ascending=False)["method"]
    table = _table(title, caption, records, "deadline_ms", "{:g} ms".format, cell, best_first)
    return replace(table, note=VERDICT_NOTE)


def _time_doubt(value_range: float) -> str:
    """What an uncertain time leaves open of a score at a deadline; empty where it is narrow."""
    return "?" if value_range != value_range else f" ±{value_range:.2f}" * (value_range >= 0.005)


def _crossover_table(records: pd.DataFrame) -> Table:
    """The frame time at which one method of a pair passes the other."""
    rows = tuple(
        (
            f"{row['method']} passes {row['other']}",
            f"{row['at_ms']:.1f}",
            _unresolved(row["low_ms"], row["high_ms"]),
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
    header = ("pair", "ms", "not resolved", "PSNR", "spp", "spp of the other")
    return Table("Crossovers", caption, header, rows)


def _unresolved(low: float, high: float) -> str:
    if low != low:
        return "-"
    start, end = ("" if x in (0, np.inf) else f"{x:.0f}" for x in (low, high))
    return f"{start} to {end}".strip() if start or end else "everywhere"


def _error_tables(
    records: pd.DataFrame, base: Curve, sample_ms: float, curves: Mapping[str, Curve]
) -> list[Table]:
    """spp and frame time at which each method has the errors of `base`."""
    times = dict(zip(base.spp.tolist(), base.frame_ms(sample_ms).tolist(), strict=True))
    return [
        _table(
            f"Samples to the error of {base.method}",
            f"spp at which each method has the PSNR that {base.method} has at the spp on top. "
            + INVERTED,
            records,
            "target",
            "{:g} spp".format,
            lambda row: _spp_cell(row, curves[row["method"]]),
        ),
        _table(
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
    """Frame time at which each method has each round PSNR."""
    return _table(
        "Time to a given PSNR",
        "Frame time in ms at which each method has the mean PSNR on top. Brackets: where the 95 % "
        "interval of the mean over scenes includes it, which is wide, since scenes differ. `<`: "
        "already at the smallest measured budget; `>`: not by the largest.",
        records,
        "target",
        "{:g} dB".format,
        lambda row: _time_cell(row, curves[row["method"]], sample_ms),
    )


def _effective_table(records: pd.DataFrame, reference: Curve) -> Table:
    """spp of `reference` that each method is worth."""
    return _table(
        f"Effective spp, in samples of {reference.method}",
        f"spp at which {reference.method} has the PSNR of the method at the spp on top: how many "
        f"samples the method is worth. {INVERTED}",
        records,
        "target",
        "{:g} spp".format,
        lambda row: _spp_cell(row, reference),
    )


def _table(
    title: str,
    caption: str,
    records: pd.DataFrame,
    column: str,
    heading: Callable[[float], str],
    cell: Callable[[Record], str],
    order: Iterable[str] = (),
) -> Table:
    """A row per method, in `order` or else by name, and a column per value of `column`."""
    if records.empty:
        return Table(title, caption, ("method",), ())
    names = dict.fromkeys([*order, *sorted(set(records["method"]))])
    header, rows = pivot(records, cell, names, column=column, heading=heading)
    return Table(title, caption, header, rows)


def _spp_cell(row: Record, curve: Curve) -> str:
    positive = curve.spp[curve.spp > 0]
    ends = (f"{positive[0]:g}", f"{positive[-1]:g}")
    return _with_ends(*(_bounded(row[name], f"{row[name]:.3g}", ends) for name in SPP_COLUMNS))


def _time_cell(row: Record, curve: Curve, sample_ms: float) -> str:
    times = curve.frame_ms(sample_ms)[curve.spp > 0]
    ends = (f"{times[0]:.1f}", f"{times[-1]:.1f}")
    pairs = zip(SPP_COLUMNS, TIME_COLUMNS, strict=True)
    text = _with_ends(*(_bounded(row[spp], f"{row[ms]:.1f}", ends) for spp, ms in pairs))
    return text + mark_uncertainty(curve.uncertainty(sample_ms))


def _bounded(spp: float, text: str, ends: tuple[str, str]) -> str:
    """The text, or a bound where the budget lies outside of the measured ones; - if unknown."""
    if spp != spp:
        return "-"
    return f"<{ends[0]}" if spp == 0 else f">{ends[1]}" if spp == np.inf else text


def _with_ends(value: str, low: str, high: str) -> str:
    return value if low == high or "-" in (low, high) else f"{value} [{low}, {high}]"
