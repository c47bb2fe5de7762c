"""Which method at which budget gives the least error in a frame time: the answer as data and text.

The command `rlbench decide` prints it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from reports.analysis.curves import (
    NOTHING,
    Curve,
    Numbers,
    curves_of,
    find_switches,
    find_winners,
    measured_sample_ms,
    meeting_costs,
    meeting_deadlines,
    methods_without_curve,
)
from reports.analysis.differences import (
    HOLM_MARK,
    LEADS,
    TRAILS,
    VERDICT_NOTE,
    describe_difference,
    holm,
    name_verdict,
)
from reports.analysis.intervals import LEVEL, UNKNOWN, Interval, interval_of
from reports.analysis.rows import ReportError, check_comparable, remarks, select_device
from reports.analysis.scores import INFERENCE, Scores
from reports.layout.tables import UNRELIABLE_MARK

LISTED = 8  # methods in the table of the text
INPUTS = {"sample_ms": "a sample costs", "frame_ms": "the deadline is"}
NEAR = 1.2  # factor between two costs of a sample that may be of one device and size


@dataclass(frozen=True)
class Candidate:
    """A method at its best budget within the deadline."""

    method: str
    spp: float
    value: Interval  # expected score, over scenes
    frame_ms: float  # inference_ms + sampling_ms
    inference_ms: float  # plan + allocate + denoise, mean of the middle half
    sampling_ms: float
    is_largest_budget: bool  # more time would buy nothing that was measured
    is_unreliable: bool  # does the clock reject a time of the method?
    difference: Interval  # to the winner, paired by scene; of the winner: nan
    verdict: str  # tie, not resolved, leads or trails; empty: no interval
    p_holm: float = math.nan  # of the difference, corrected for all candidates


@dataclass(frozen=True)
class BreakEven:
    """The nearest value of one input, in ms, at which another method wins."""

    changed: str  # sample_ms or frame_ms
    direction: str  # lower or higher
    at_ms: float | None  # None: the winner stays
    method: str | None  # that wins beyond it; None where no method fits


@dataclass(frozen=True)
class Decision:
    """The answer and what it rests on. Times in ms; the winner first, the others by their score."""

    sample_ms: float
    frame_ms: float
    metric: str
    unit: str
    convention: str
    direction: str
    candidates: tuple[Candidate, ...]
    changes: tuple[BreakEven, ...]
    scenes: tuple[str, ...]
    inference_device: str
    image_sizes: tuple[str, ...]  # WIDTHxHEIGHT that inference was measured at
    measured_sample_ms: float  # cost of a sample in the results, which the answer does not use
    measured_sample_source: str
    notes: tuple[str, ...]


def decide(
    results: pd.DataFrame,
    sample_ms: float,
    frame_ms: float,
    metric: str = "psnr",
    device: str = "",
    left_out: Sequence[str] = (),
    allow_unreliable: bool = False,
) -> Decision:
    """The method with the best expected score among those that fit `frame_ms`, and its rivals.

    `sample_ms` is the time of one path sample for each pixel; the time of a frame is plan +
    allocate + denoise (from the results) + samples x `sample_ms`, mean over scenes. `device` names
    the device whose times are used, where the results have several. `left_out` are sentences about
    rows that were not considered. Budgets with unreliable times are left out, or marked with
    `allow_unreliable`. Raises ReportError if no method fits or has times, if all times are
    unreliable, or if rows cannot be compared.
    """
    rows, device = select_device(results, device)
    check_comparable(rows)
    scores = Scores(rows, metric, device)
    check_ranks(scores)
    curves = curves_of(scores, allow_unreliable)
    if not curves and curves_of(scores):
        raise ReportError(
            f"all times are unreliable: {scores.unreliable_times[0]}. Measure them again on a "
            "quiet machine: rlbench run --retime; or see the answer marked: --allow-unreliable"
        )
    if not curves:
        raise ReportError(
            f"no method has {metric} and times on every scene; found: "
            f"{'; '.join(methods_without_curve(scores, []))}. Measure with rlbench run"
        )
    doubted = set(scores.points["method"][scores.points["unreliable"]])
    ranked = _candidates(curves, sample_ms, frame_ms, scores.column_text("unit"))
    if allow_unreliable:
        ranked = tuple(replace(c, is_unreliable=c.method in doubted) for c in ranked)
    if not ranked:
        raise _nothing_fits(curves, sample_ms, frame_ms)
    timed = rows[rows["metric"].isin(INFERENCE) & rows["method"].isin([c.method for c in curves])]
    return Decision(
        sample_ms=sample_ms,
        frame_ms=frame_ms,
        metric=metric,
        unit=scores.column_text("unit"),
        convention=scores.convention,
        direction=scores.direction,
        candidates=ranked,
        changes=tuple(_break_evens(curves, sample_ms, frame_ms)),
        scenes=tuple(sorted(set(scores.scene_means["scene"]))),
        inference_device=device,
        image_sizes=tuple(sorted(set(timed["size"]) - {""})),
        measured_sample_ms=measured_sample_ms(scores),
        measured_sample_source=scores.cost_source,
        notes=(
            *left_out,
            *methods_without_curve(scores, curves),
            *(f"unreliable: {line}" for line in scores.unreliable_times),
            *remarks(timed),
        ),
    )


def check_ranks(scores: Scores) -> None:
    """Raise ReportError if the metric has no values, or none that rank methods."""
    if scores.measured.empty or scores.direction not in ("higher", "lower"):
        rows = scores.rows
        ranked = rows[rows["value"].notna() & (rows["direction"] != "") & (rows["unit"] != "ms")]
        raise ReportError(
            f"metric '{scores.metric}' was requested, and the results have no values of it that "
            f"rank methods; metrics that do: {', '.join(sorted(set(ranked['metric']))) or 'none'}"
        )


def _candidates(
    curves: Sequence[Curve], sample_ms: float, frame_ms: float, unit: str
) -> tuple[Candidate, ...]:
    """Every method that fits the deadline, the best first; empty if none does."""
    winners = find_winners(curves, np.array([sample_ms]), np.array([frame_ms]))
    spp = winners.spp[:, 0]
    ranked = [int(index) for index in winners.order[:, 0] if not math.isnan(spp[index])]
    best = [curves[index].units_at(spp[index]) for index in ranked[:1]]
    found = []
    for index in ranked:
        curve, units = curves[index], curves[index].units_at(spp[index])
        gap = UNKNOWN if index == ranked[0] else interval_of(units - best[0])
        frame = float(curve.frame_ms_at(spp[index], sample_ms))
        sampling = float(np.interp(spp[index], curve.spp, curve.samples)) * sample_ms
        found.append(
            Candidate(
                method=curve.method,
                spp=float(spp[index]),
                value=interval_of(units),
                frame_ms=frame,
                inference_ms=frame - sampling,
                sampling_ms=sampling,
                is_largest_budget=bool(spp[index] == curve.spp[-1]),
                is_unreliable=False,
                difference=gap,
                verdict=name_verdict(gap, unit, curve.direction),
            )
        )
    p_holm = holm([candidate.difference.p_value for candidate in found])
    return tuple(replace(c, p_holm=float(p)) for c, p in zip(found, p_holm, strict=True))


def _break_evens(curves: Sequence[Curve], sample_ms: float, frame_ms: float) -> Iterator[BreakEven]:
    """The nearest lower and higher cost of a sample, and deadline, at which another method wins."""

    def by_cost(costs: Numbers) -> NDArray[np.intp]:
        return find_winners(curves, costs, np.full_like(costs, frame_ms)).first

    def by_deadline(deadlines: Numbers) -> NDArray[np.intp]:
        return find_winners(curves, np.full_like(deadlines, sample_ms), deadlines).first

    inputs: dict[str, tuple[float, Callable[[Numbers], NDArray[np.intp]], list[float]]] = {
        "sample_ms": (sample_ms, by_cost, meeting_costs(curves, frame_ms)),
        "frame_ms": (frame_ms, by_deadline, meeting_deadlines(curves, sample_ms)),
    }
    for changed, (now, winner, points) in inputs.items():
        switches = find_switches(winner, [*points, now])
        below = next((s for s in reversed(switches) if s.at <= now), None)
        above = next((s for s in switches if s.at > now), None)
        for direction, found in (("lower", below), ("higher", above)):
            if found is None:
                yield BreakEven(changed, direction, None, None)
                continue
            index = found.before if direction == "lower" else found.after
            method = None if index == NOTHING else curves[index].method
            yield BreakEven(changed, direction, found.at, method)


def _nothing_fits(curves: Sequence[Curve], sample_ms: float, frame_ms: float) -> ReportError:
    needed, method, spp = min(
        (float(time), curve.method, float(spp))
        for curve in curves
        for spp, time in zip(curve.spp, curve.frame_ms(sample_ms), strict=True)
    )
    return ReportError(
        f"no method fits {frame_ms:g} ms at {sample_ms:g} ms a sample; the cheapest, {method} at "
        f"{spp:g} spp, needs {needed:.3g} ms. Raise --frame-ms, "
        "or measure smaller budgets or smaller images: rlbench run --spp 0.25"
    )


def decision_text(decision: Decision, sample_device: str = "") -> str:
    """Lines for people: the answer, how sure it is, what would change it, its limits.

    `sample_device` is the device of `decision.sample_ms`, if it is known.
    """
    return "\n".join(
        [
            *_answer(decision),
            "",
            *_aligned(list(_table(decision))),
            "",
            "What would change the answer:",
            *(f"  {_change(change, decision)}" for change in decision.changes),
            "",
            *_basis(decision, sample_device),
        ]
    )


def _answer(decision: Decision) -> Iterator[str]:
    best, *others = decision.candidates
    yield (
        f"{best.method} at {best.spp:.3g} spp: {_metric(decision)} "
        f"{_number(best.value.mean, decision)} {decision.unit}".rstrip()
        + f" {_ends(best.value, decision)} over "
        f"{len(decision.scenes)} scene{'s' * (len(decision.scenes) != 1)}, in {best.frame_ms:.3g} "
        f"of {decision.frame_ms:g} ms{_doubt(best)} ({best.inference_ms:.3g} inference + "
        f"{best.sampling_ms:.3g} sampling)."
    )
    if best.is_largest_budget:
        yield (
            f"{best.spp:g} spp is its largest measured budget: more may fit. "
            f"Measure it: rlbench run -m {best.method} --spp {2 * best.spp:g}"
        )
    if not others:
        yield "No other method fits."
        return
    gap = describe_difference(others[0].difference, decision.unit, decision.direction)
    mark = _mark(others[0])
    yield f"Runner-up: {others[0].method} at {others[0].spp:.3g} spp: {gap}{mark}."


def _table(decision: Decision) -> Iterator[tuple[str, ...]]:
    unit = f" [{decision.unit}]" * bool(decision.unit)
    yield ("method", "spp", "frame ms", _metric(decision) + unit, "difference", "")
    for row in decision.candidates[:LISTED]:
        gap = row.difference
        difference = f"{_number(gap.mean, decision, '+')} {_ends(gap, decision, '+')}".strip()
        yield (
            row.method,
            f"{row.spp:.3g}",
            f"{row.frame_ms:.3g}{_doubt(row)}",
            _number(row.value.mean, decision),
            "" if row is decision.candidates[0] else difference,
            row.verdict + _mark(row),
        )


def _doubt(row: Candidate) -> str:
    """The mark of a time that the clock rejects."""
    return UNRELIABLE_MARK * row.is_unreliable


def _mark(row: Candidate) -> str:
    """The mark of a lead that Holm's correction takes away."""
    return HOLM_MARK * (row.verdict in (LEADS, TRAILS) and row.p_holm > 1 - LEVEL)


def _change(change: BreakEven, decision: Decision) -> str:
    bound = "below" if change.direction == "lower" else "above"
    noun = "cost of a sample" if change.changed == "sample_ms" else "deadline"
    if change.at_ms is None:
        name = decision.candidates[0].method
        return f"{name} wins at any {change.direction} {noun}, up to its measured budgets"
    outcome = f"{change.method} wins" if change.method else "no method fits"
    return f"{outcome} where {INPUTS[change.changed]} {bound} {change.at_ms:.3g} ms"


def _basis(decision: Decision, sample_device: str) -> Iterator[str]:
    size = ", ".join(decision.image_sizes) or "an image size that these results do not state"
    device = decision.inference_device or "an unnamed device"
    yield (
        f"Inference (plan + allocate + denoise) was measured on {device}, at {size}; "
        "it is not scaled to another device or size."
    )
    ratio = decision.measured_sample_ms / decision.sample_ms
    if sample_device and sample_device != device:
        yield (
            f"Warning: a sample costs {decision.sample_ms:g} ms on {sample_device}, another device "
            "than that of inference. Measure both on one: rlbench run, there"
        )
    elif not sample_device and (ratio > NEAR or ratio < 1 / NEAR):
        yield (
            f"Warning: these results charge {decision.measured_sample_ms:.3g} ms for a sample "
            f"({decision.measured_sample_source}), so {decision.sample_ms:g} ms is probably of "
            "another device or size than inference. Measure both on one: rlbench run, there"
        )
    yield (
        f"{_metric(decision)}: {decision.convention}; between measured budgets linear in log spp. "
        f"Differences are paired by scene. {VERDICT_NOTE} It is for all "
        "methods that fit."
    )
    yield from decision.notes


def _metric(decision: Decision) -> str:
    return "PSNR" if decision.metric == "psnr" else decision.metric


def _number(value: float, decision: Decision, sign: str = "") -> str:
    return f"{value:{sign}{'.2f' if decision.unit == 'dB' else '.3g'}}"


def _ends(interval: Interval, decision: Decision, sign: str = "") -> str:
    if not interval.is_known:
        return ""
    low, high = (_number(end, decision, sign) for end in (interval.low, interval.high))
    return f"[{low}, {high}]"


def _aligned(lines: list[tuple[str, ...]]) -> list[str]:
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    sides = "<>>><<"
    return [
        "  ".join(
            f"{cell:{side}{width}}" for cell, side, width in zip(line, sides, widths, strict=True)
        ).rstrip()
        for line in lines
    ]
