"""The regression check: PSNR per method, scene and budget against a baseline."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from rlbench.benchmark.regression.baseline import (
    Baseline,
    BaselineEntry,
    BaselineError,
    ScoreKey,
)
from rlbench.benchmark.regression.scores import DECIMALS, Score, only_preset, scores
from rlbench.benchmark.regression.speed_gate import SLOWER, SpeedResult
from rlbench.benchmark.results import UNRELIABLE

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["FAILING", "BaselineDiff", "RegressionReport", "compare", "unreliable_times"]

SHOWN_DB = 0.01  # a fall by this much is shown, even where it is allowed
FAILING = ("worse", "missing")
SHOWN = (*FAILING, "lower", "better", "new")  # in this order
COLUMNS = ("", "method", "scene", "spp", "baseline", "+-", "measured", "change", "allowed")


@dataclass(frozen=True)
class BaselineDiff:
    """One line of the comparison."""

    key: ScoreKey
    verdict: str  # worse, missing, lower, better, new, same, or skipped
    expected: float | None  # dB; None where the baseline has no entry
    measured: float | None  # dB; None where the results have no value
    tolerance_db: float  # allowed fall
    stderr_db: float | None = None  # of the expected mean over frames

    @property
    def change(self) -> float | None:
        """Rise of PSNR in dB; None where one side is missing."""
        if self.expected is None or self.measured is None:
            return None
        # 29.95 - 30 has to be -0.05, which is within 0.05
        return round(self.measured - self.expected, DECIMALS)

    @property
    def cells(self) -> tuple[str, ...]:
        """The line as text, in the order of `COLUMNS`; a dash where there is no number."""
        allowed = None if self.expected is None else -self.tolerance_db
        signed = (f"{_dash(self.change, '+.3f')}", _dash(allowed, ".3f"))
        numbers = [_dash(v, ".3f") for v in (self.expected, self.stderr_db, self.measured)]
        verdict = self.verdict.upper() if self.verdict in FAILING else self.verdict
        spp = f"{self.key.target_spp:g}"
        return verdict, self.key.method, self.key.scene, spp, *numbers, *signed


@dataclass(frozen=True)
class RegressionReport:
    """The comparison of results with a baseline, line by line."""

    diffs: tuple[BaselineDiff, ...]
    unreliable: tuple[ScoreKey, ...] = ()  # with times that failed their test; they gate nothing
    speed: tuple[SpeedResult, ...] = ()

    @property
    def has_passed(self) -> bool:
        """Was anything compared, with nothing worse, missing or slower than its gate?"""
        failed = any(diff.verdict in FAILING for diff in self.diffs)
        slower = any(result.verdict == SLOWER for result in self.speed)
        return not failed and not slower and not self.is_empty

    @property
    def is_empty(self) -> bool:
        """Is there no entry with a result?"""
        return all(None in (diff.expected, diff.measured) for diff in self.diffs)

    @property
    def shown(self) -> list[BaselineDiff]:
        """The lines that differ, failures first."""
        return [diff for verdict in SHOWN for diff in self.with_verdict(verdict)]

    @property
    def worst(self) -> BaselineDiff | None:
        """The line with the largest fall, of those that are shown."""
        falls = [diff for diff in self.shown if diff.change is not None and diff.change < 0]
        return min(falls, key=lambda diff: diff.change or 0.0, default=None)

    @property
    def summary(self) -> str:
        """The result, and how many lines have each verdict."""
        verdicts = (*SHOWN, "same", "skipped")
        counts = {verdict: len(self.with_verdict(verdict)) for verdict in verdicts}
        words = [f"{count} {verdict}" for verdict, count in counts.items() if count]
        words = ["nothing was compared"] * self.is_empty + words
        words += [f"speed {result.verdict}" for result in self.speed]
        return f"{'passed' if self.has_passed else 'FAILED'}: {', '.join(words)}"

    def with_verdict(self, verdict: str) -> list[BaselineDiff]:
        """The lines with this verdict."""
        return [diff for diff in self.diffs if diff.verdict == verdict]

    def text(self) -> str:
        """The differences as a table, failures first, and a summary in the last line.

        Unreliable times are named before it; scores do not depend on them.
        """
        lines = [diff.cells for diff in self.shown]
        table = _aligned([COLUMNS, *lines]) if lines else []
        speed = [str(result) for result in self.speed]
        return "\n".join([*table, *speed, *_unreliable_lines(self.unreliable), self.summary])


def compare(table: pd.DataFrame, baseline: Baseline, subset: bool = False) -> RegressionReport:
    """Compare every entry of the baseline with the results table.

    An entry is worse if it fell by more than its tolerance, lower if it fell by less but by 0.01 dB
    or more, and better if it rose by more than its tolerance. A result without an entry is new. An
    entry without a result is missing, or skipped if `table` is known to be a `subset` and has other
    results of the method. A result with a frame without a value is missing either way. Scores are
    those of the baseline's seed. Raises BaselineError for results of another preset or without that
    seed, and as `scores` does.
    """
    if len(table) and (preset := only_preset(table)) != baseline.preset:
        raise BaselineError(
            f"the results are of preset {preset or 'none'}, the baseline of "
            f"{baseline.preset or 'none'}. Measure that preset, or pass another --baseline"
        )
    measured = scores(table, baseline.seed)
    expected = {entry.key: entry for entry in baseline.entries}
    if len(expected) < len(baseline.entries):
        raise BaselineError(
            "the baseline has two entries of one method, scene and budget. Remove one"
        )
    incomplete = {key.method for key in measured} if subset else set()
    diffs = [_diff(entry, baseline, measured, incomplete) for entry in baseline.entries]
    for key in sorted(measured.keys() - expected.keys()):
        if score := measured[key]:
            diffs.append(BaselineDiff(key, "new", None, score.psnr, baseline.tolerance_db))
    return RegressionReport(tuple(diffs), unreliable_times(table))


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


def _diff(
    entry: BaselineEntry,
    baseline: Baseline,
    measured: Mapping[ScoreKey, Score | None],
    incomplete: Collection[str],  # methods whose cells may be absent
) -> BaselineDiff:
    limit = baseline.tolerance_db if entry.tolerance_db is None else entry.tolerance_db
    score = measured.get(entry.key)
    if score is None:
        is_absent = entry.key not in measured
        verdict = "skipped" if is_absent and entry.method in incomplete else "missing"
        return BaselineDiff(entry.key, verdict, entry.psnr, None, limit, entry.stderr_db)
    rise = round(score.psnr - entry.psnr, DECIMALS)
    return BaselineDiff(
        entry.key, _verdict(rise, limit), entry.psnr, score.psnr, limit, entry.stderr_db
    )


def _verdict(rise: float, limit: float) -> str:
    if rise < -limit:
        return "worse"
    if rise > limit:
        return "better"
    return "lower" if rise <= -SHOWN_DB else "same"


def _dash(value: float | None, style: str) -> str:
    return "-" if value is None or math.isnan(value) else format(value, style)


def _aligned(lines: list[tuple[str, ...]]) -> list[str]:
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    formats = [f"{'<' if column < 3 else '>'}{width}" for column, width in enumerate(widths)]
    return ["  ".join(map(format, line, formats)) for line in lines]
