"""The regression check: PSNR per method, scene and budget against a baseline, and gates of speed.

A gate is the largest ratio of two rows' inference times. A time belongs to a machine, the ratio of
two much less so. Both rows run in the same interleaved rounds (`rlbench.benchmark.latency`) on
generated frames, so that a drift of the machine meets both.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from rlbench.benchmark.regression.baseline import (
    DECIMALS,
    Baseline,
    BaselineEntry,
    BaselineError,
    Score,
    ScoreKey,
    only_preset,
    scores,
)
from rlbench.benchmark.results import UNCERTAIN
from rlbench.errors import OptionError, PluginError

if TYPE_CHECKING:
    import pandas as pd
    import torch

    from rlbench.benchmark.latency import Timing
    from rlbench.benchmark.speed import Configuration

SHOWN_DB = 0.01  # a fall by this much is shown, even where it is allowed
FAILING = ("worse", "missing")
SHOWN = (*FAILING, "lower", "better", "new")  # in this order
COLUMNS = ("", "method", "scene", "spp", "baseline", "+-", "measured", "change", "allowed")
SLOWER, WITHIN, NOT_RESOLVED, UNDECIDED = "slower", "within", "not resolved", "undecided"
REPEATS = 30  # timed frames of a row, at least
SIZE = (192, 192)  # pixels, height and width of the generated frames; that of preset mini


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
    uncertain: tuple[ScoreKey, ...] = ()  # with times of a wide interval; they gate nothing
    speed: tuple[SpeedResult, ...] = ()

    @property
    def has_passed(self) -> bool:
        """True if something was compared, and nothing is worse, missing or slower than its gate."""
        failed = any(diff.verdict in FAILING for diff in self.diffs)
        slower = any(result.verdict == SLOWER for result in self.speed)
        return not failed and not slower and not self.is_empty

    @property
    def is_empty(self) -> bool:
        """True if there is no entry with a result."""
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

        Uncertain times are named before it; scores do not depend on them.
        """
        lines = [diff.cells for diff in self.shown]
        table = _aligned([COLUMNS, *lines]) if lines else []
        speed = [str(result) for result in self.speed]
        return "\n".join([*table, *speed, *_uncertain_lines(self.uncertain), self.summary])


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
    return RegressionReport(tuple(diffs), uncertain_times(table))


def uncertain_times(table: pd.DataFrame) -> tuple[ScoreKey, ...]:
    """Method, scene and budget of the times with a wide interval."""
    rows = table[(table["unit"] == "ms") & table["note"].str.startswith(UNCERTAIN)]
    keys = rows[["method", "scene", "target_spp"]].drop_duplicates()
    return tuple(sorted(ScoreKey(*key) for key in keys.itertuples(index=False, name=None)))


def _uncertain_lines(keys: Sequence[ScoreKey]) -> list[str]:
    """One line for each method with uncertain times."""
    lines = []
    for method in sorted({key.method for key in keys}):
        cells = [f"{key.scene} at {key.target_spp:g} spp" for key in keys if key.method == method]
        lines.append(f"uncertain times of {method}, which gate nothing: {', '.join(cells)}")
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


@dataclass(frozen=True)
class SpeedGate:
    """The largest ratio of two inference times that passes."""

    row: str  # name of a row, such as ours or ours@half
    reference: str  # name of the row that its time is divided by
    max_ratio: float

    def __str__(self) -> str:
        """The gate as it is written in a baseline."""
        return f"{self.row} / {self.reference} <= {self.max_ratio:g}"


@dataclass(frozen=True)
class SpeedResult:
    """What was measured of a gate."""

    gate: SpeedGate
    verdict: str  # slower, within, not resolved, or undecided
    ratio: float = math.nan  # of the medians
    low: float = math.nan  # ends of an interval that holds the ratio with probability 0.9
    high: float = math.nan
    reason: str = ""  # why it is undecided

    def __str__(self) -> str:
        """The result as one line of text."""
        text = f"speed {self.verdict}: {self.gate}"
        if self.reason:
            return f"{text}: {self.reason}"
        return f"{text}, measured {self.ratio:.3f} [{self.low:.3f}, {self.high:.3f}]"


def parse_gate(text: str) -> SpeedGate:
    """The gate in `A/B<=1.3`, where A and B name rows of installed methods.

    >>> parse_gate("ours/oidn<=1.3")
    SpeedGate(row='ours', reference='oidn', max_ratio=1.3)
    >>> parse_gate("oidn/tuned / oidn <= 1")
    SpeedGate(row='oidn/tuned', reference='oidn', max_ratio=1.0)

    Raises OptionError for another form, an unknown method, or a name that can be split in two ways.
    """
    names, _, limit = text.partition("<=")
    try:
        max_ratio = float(limit)
    except ValueError:
        max_ratio = math.nan
    if not 0 < max_ratio < math.inf:
        raise OptionError(f"'{text}' is not a bound. Write A/B<=1.3, for example ours/oidn<=1.3")
    separator = " / " if " / " in names else "/"
    cuts = [match.start() for match in re.finditer(re.escape(separator), names)]
    pairs = [(names[:cut].strip(), names[cut + len(separator) :].strip()) for cut in cuts]
    known = [pair for pair in pairs if all(map(_is_known, pair))]
    if len(known) != 1:
        found = " and ".join(f"'{a}' / '{b}'" for a, b in known) or "no two installed methods"
        raise OptionError(f"'{text}' names {found}. Write two rows with spaces, A / B<=1.3")
    return SpeedGate(*known[0], max_ratio)


def measure_gates(
    gates: Sequence[SpeedGate],
    device: torch.device,
    repeats: int = REPEATS,
    on_done: Callable[[], None] = lambda: None,
) -> list[SpeedResult]:
    """Time the rows of all gates in interleaved rounds, and judge each gate.

    A row that several gates name is timed once. `on_done` is called for each row that is done.
    Raises OptionError for a row that fails.
    """
    from rlbench.benchmark.latency import TimedRow, time_methods
    from rlbench.benchmark.speed import generated_clip, timed_spp

    names = list(dict.fromkeys(name for gate in gates for name in (gate.row, gate.reference)))
    clip = generated_clip(SIZE, device)
    methods = [_configuration(name).load(device) for name in names]
    rows = [TimedRow(method, clip, timed_spp(method)) for method in methods]
    timings: dict[str, Timing] = {}
    outcomes = time_methods(rows, device, repeats, on_done=on_done)
    for name, outcome in zip(names, outcomes, strict=True):
        if isinstance(outcome, Exception):
            raise OptionError(
                f"--speed: {name} cannot be timed: {type(outcome).__name__}: {outcome}. Correct "
                "the method, or remove the gate"
            )
        timings[name] = outcome
    return [judge(gate, timings[gate.row], timings[gate.reference]) for gate in gates]


def judge(gate: SpeedGate, row: Timing, reference: Timing) -> SpeedResult:
    """The verdict on a gate: slower only if the whole interval of the ratio exceeds it.

    The ends are those of the clock's 95 % intervals of the two medians, divided. The true ratio is
    below the lower end with probability 0.05 at most (Bonferroni over one end of each), so that is
    how often a gate fails by chance. A ratio of a time from a
    busy machine is refused: undecided.
    """
    for name, timing in ((gate.row, row), (gate.reference, reference)):
        if timing.disturbance:
            reason = f"the time of {name} is uncertain: {timing.disturbance}"
            return SpeedResult(gate, UNDECIDED, reason=reason)
    ratio = row.inference.p50 / reference.inference.p50
    low = ratio * (1 - row.half_width) / (1 + reference.half_width)
    high = ratio * (1 + row.half_width) / (1 - reference.half_width)
    verdict = SLOWER if low > gate.max_ratio else WITHIN if high <= gate.max_ratio else NOT_RESOLVED
    return SpeedResult(gate, verdict, ratio, low, high)


def _configuration(name: str) -> Configuration:
    """The method of a row, with the backend and precision that its label names."""
    from rlbench.benchmark.results import RowName
    from rlbench.benchmark.speed import Configuration

    row = RowName.parse(name)
    return Configuration(row.method_name, row.options.backend, row.options.half)


def _is_known(name: str) -> bool:
    """True for a row of an installed method, with no label of weights or of tiles.

    No generated frame has tiles without changes.
    """
    from rlbench import registry
    from rlbench.benchmark.results import RowName

    row = RowName.parse(name)
    try:
        registry.get_variant(row.method_name)
    except PluginError:
        return False
    return not row.options.weights and not row.options.skip_tiles
