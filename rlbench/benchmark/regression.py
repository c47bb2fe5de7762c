"""The regression check: PSNR per method, scene and budget against a committed baseline."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from rlbench.benchmark.baseline import (
    Baseline,
    BaselineEntry,
    BaselineError,
    ScoreKey,
    load_baseline,
    write_baseline,
)
from rlbench.benchmark.results import UNRELIABLE, WHOLE_CLIP

if TYPE_CHECKING:
    import pandas as pd

__all__ = [
    "BaselineDiff",
    "RegressionReport",
    "compare",
    "mean_psnr",
    "unreliable_times",
    "update_baseline",
]

DECIMALS = 4  # of dB, in the file and in the comparison
FAILING = ("worse", "missing")
COLUMNS = ("", "method", "scene", "spp", "baseline", "measured", "change", "allowed")


@dataclass(frozen=True)
class BaselineDiff:
    """One line of the comparison."""

    key: ScoreKey
    verdict: str  # worse, missing, better, new, same, or skipped
    expected: float | None  # dB; None where the baseline has no entry
    measured: float | None  # dB; None where the results have no value
    tolerance_db: float


@dataclass(frozen=True)
class RegressionReport:
    """The comparison of results with a baseline, line by line."""

    diffs: tuple[BaselineDiff, ...]
    unreliable: tuple[ScoreKey, ...] = ()  # with times that failed their test; they gate nothing

    @property
    def has_passed(self) -> bool:
        """Was anything compared, with nothing worse and nothing missing?"""
        failed = any(diff.verdict in FAILING for diff in self.diffs)
        return not failed and not self.is_empty

    @property
    def is_empty(self) -> bool:
        """Is there no entry with a result?"""
        return all(None in (diff.expected, diff.measured) for diff in self.diffs)

    def with_verdict(self, verdict: str) -> list[BaselineDiff]:
        """The lines with this verdict."""
        return [diff for diff in self.diffs if diff.verdict == verdict]

    def text(self) -> str:
        """The differences as a table, failures first, and a summary in the last line.

        Unreliable times are named before it; scores do not depend on them.
        """
        order = ("worse", "missing", "better", "new")
        lines = [_line(diff) for verdict in order for diff in self.with_verdict(verdict)]
        verdicts = (*order, "same", "skipped")
        counts = {verdict: len(self.with_verdict(verdict)) for verdict in verdicts}
        summary = [f"{count} {verdict}" for verdict, count in counts.items() if count]
        summary = ["nothing was compared"] * self.is_empty + summary
        result = f"{'passed' if self.has_passed else 'FAILED'}: {', '.join(summary)}"
        table = _aligned([COLUMNS, *lines]) if lines else []
        return "\n".join([*table, *_unreliable_lines(self.unreliable), result])


def compare(table: pd.DataFrame, baseline: Baseline, subset: bool = False) -> RegressionReport:
    """Compare every entry of the baseline with the results table.

    An entry is worse if it fell by more than its tolerance, and better if it rose by more. A
    result without an entry is new. An entry without a result is missing, or skipped if `table` is
    known to be a `subset` and has other results of the method. A result with a frame without a
    value is missing either way. Raises BaselineError for results of another preset, and as
    `mean_psnr` does.
    """
    if len(table) and (preset := _preset(table)) != baseline.preset:
        raise BaselineError(
            f"the results are of preset {preset or 'none'}, the baseline of "
            f"{baseline.preset or 'none'}. Measure that preset, or pass another --baseline"
        )
    measured, expected = mean_psnr(table), {entry.key: entry for entry in baseline.entries}
    if len(expected) < len(baseline.entries):
        raise BaselineError(
            "the baseline has two entries of one method, scene and budget. Remove one"
        )
    incomplete = {key.method for key in measured} if subset else set()
    diffs = [_diff(entry, baseline, measured, incomplete) for entry in baseline.entries]
    for key in sorted(measured.keys() - expected.keys()):
        if measured[key] is not None:
            diffs.append(BaselineDiff(key, "new", None, measured[key], baseline.tolerance_db))
    return RegressionReport(tuple(diffs), unreliable_times(table))


def update_baseline(table: pd.DataFrame, path: Path) -> Baseline:
    """Rewrite the baseline at `path` from the results; tolerances and command are kept.

    Entries without a result are dropped, so run the whole preset first. Cells that were skipped,
    such as budgets a method does not support, are left out. Raises BaselineError if a frame has no
    value, if a skipped cell has an entry in the old baseline, and as `mean_psnr` does.
    """
    old = load_baseline(path) if path.exists() else Baseline()
    tolerances = {entry.key: entry.tolerance_db for entry in old.entries}
    measured = mean_psnr(table[table["frame"] != WHOLE_CLIP])
    lost = {key for key, psnr in mean_psnr(table).items() if psnr is None} & tolerances.keys()
    holes = sorted({key for key, psnr in measured.items() if psnr is None} | lost)
    if holes or not measured:
        named = ", ".join(map(str, holes)) or "anything"
        raise BaselineError(f"the results cannot be a baseline: no PSNR of {named}")
    entries = tuple(
        BaselineEntry(*key, psnr=psnr, tolerance_db=tolerances.get(key))
        for key, psnr in sorted(measured.items())
        if psnr is not None
    )
    new = replace(old, preset=_preset(table), entries=entries)
    write_baseline(new, path)
    return new


def mean_psnr(table: pd.DataFrame) -> dict[ScoreKey, float | None]:
    """Mean PSNR in dB of each method, scene and budget, or None if a frame has no finite value.

    Raises BaselineError if the results are of several devices.
    """
    rows = table[table["metric"] == "psnr"]
    if len(devices := sorted(set(rows["device"]) - {""})) > 1:
        raise BaselineError(
            f"the results are of {len(devices)} devices ({', '.join(devices)}). Measure on one "
            "device, into a folder of its own"
        )
    groups = rows.groupby(["method", "scene", "target_spp"])["value"]
    means = groups.agg(lambda values: values.mean(skipna=False))
    return {
        ScoreKey(*key): round(psnr, DECIMALS) if math.isfinite(psnr) else None
        for key, psnr in zip(means.index, means, strict=True)
    }


def unreliable_times(table: pd.DataFrame) -> tuple[ScoreKey, ...]:
    """Method, scene and budget of the times that failed their test."""
    rows = table[(table["unit"] == "ms") & table["note"].str.startswith(UNRELIABLE)]
    keys = rows[["method", "scene", "target_spp"]].drop_duplicates()
    return tuple(sorted(ScoreKey(*key) for key in keys.itertuples(index=False, name=None)))


def _unreliable_lines(keys: Sequence[ScoreKey]) -> list[str]:
    """One line for each method with unreliable times."""
    lines = []
    for method in sorted({key.method for key in keys}):
        cells = [f"{key.scene} at {key.target_spp:g} spp" for key in keys if key.method == method]
        lines.append(f"unreliable times of {method}, which gate nothing: {', '.join(cells)}")
    return lines


def _preset(table: pd.DataFrame) -> str:
    """The preset of all clips. Raises BaselineError if there are several."""
    presets = sorted(set(table["preset"]))
    if len(presets) > 1:
        names = ", ".join(preset or "none" for preset in presets)
        raise BaselineError(
            f"the results are of {len(presets)} presets ({names}). Measure one preset only"
        )
    return presets[0] if presets else ""


def _diff(
    entry: BaselineEntry,
    baseline: Baseline,
    measured: Mapping[ScoreKey, float | None],
    incomplete: Collection[str],  # methods whose cells may be absent
) -> BaselineDiff:
    limit = baseline.tolerance_db if entry.tolerance_db is None else entry.tolerance_db
    psnr = measured.get(entry.key)
    if psnr is None:
        is_absent = entry.key not in measured
        verdict = "skipped" if is_absent and entry.method in incomplete else "missing"
        return BaselineDiff(entry.key, verdict, entry.psnr, None, limit)
    rise = round(psnr - entry.psnr, DECIMALS)  # 29.95 - 30 has to be -0.05, which is within 0.05
    verdict = "worse" if rise < -limit else "better" if rise > limit else "same"
    return BaselineDiff(entry.key, verdict, entry.psnr, psnr, limit)


def _line(diff: BaselineDiff) -> tuple[str, ...]:
    expected, measured = (math.nan if v is None else v for v in (diff.expected, diff.measured))
    figures = [f"{expected:.3f}", f"{measured:.3f}", f"{measured - expected:+.3f}"]
    allowed = "-" if diff.expected is None else f"-{diff.tolerance_db:.3f}"
    verdict = diff.verdict.upper() if diff.verdict in FAILING else diff.verdict
    numbers = ("-" if "nan" in figure else figure for figure in figures)
    return verdict, diff.key.method, diff.key.scene, f"{diff.key.target_spp:g}", *numbers, allowed


def _aligned(lines: list[tuple[str, ...]]) -> list[str]:
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    formats = [f"{'<' if column < 3 else '>'}{width}" for column, width in enumerate(widths)]
    return ["  ".join(map(format, line, formats)) for line in lines]
