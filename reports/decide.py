"""Which method at which budget gives the least error in a frame time: the answer as data.

The command `rlbench decide` prints it as `reports.decision_text` words it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from reports.analysis.curves import (
    NOTHING,
    Curve,
    Numbers,
    curves_of,
    denoisers,
    find_possible_winners,
    find_switches,
    find_winners,
    measured_sample_ms,
    meeting_costs,
    meeting_deadlines,
    methods_without_curve,
)
from reports.analysis.differences import holm, name_verdict
from reports.analysis.intervals import UNKNOWN, Interval, interval_of
from reports.analysis.rows import (
    ReportError,
    charge_gbuffer,
    check_comparable,
    methods_from_elsewhere,
    remarks,
    select_device,
    without_label,
)
from reports.analysis.scores import ENDS, INFERENCE, Scores

NAMED = 6  # methods in a suggested command; more are all


@dataclass(frozen=True)
class GivenTimes:
    """Times of a cost profile: of methods, at one size, and of a sample."""

    device: str
    size: str  # WIDTHxHEIGHT
    source: str
    sample_ms: float
    inference_ms: Mapping[str, float]  # by row of the results


@dataclass(frozen=True)
class Candidate:
    """A method at its best budget within the deadline."""

    method: str
    spp: float
    value: Interval  # expected score, over scenes
    frame_ms: float  # gbuffer_ms + inference_ms + sampling_ms
    gbuffer_ms: float  # 0 for a method that reads none
    inference_ms: float  # plan + allocate + denoise, mean of the middle half
    sampling_ms: float
    is_largest_budget: bool  # more time would buy nothing that was measured
    low_ms: float  # ends of the interval of frame_ms, from that of inference alone
    high_ms: float
    is_claimed: bool  # its images and time were made elsewhere
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
    could_win: tuple[str, ...]  # other methods that win at other ends of the times' intervals
    uncertainty: float  # of the times of the winner and of these, as a share
    undenoised: Candidate | None  # the best image without a denoiser, which cannot win
    changes: tuple[BreakEven, ...]
    scenes: tuple[str, ...]
    inference_device: str
    device_mixes: tuple[str, ...]  # where samples were timed on another device than inference
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
    strict: bool = False,
    gbuffer_ms: float | None = None,
    given: GivenTimes | None = None,
    plugins: str = "",
) -> Decision:
    """The denoiser with the best expected score among those that fit `frame_ms`, and its rivals.

    `sample_ms` is the time of one path sample for each pixel; the time of a frame is G-buffer +
    plan + allocate + denoise (from the results, or `given`) + samples x `sample_ms`, mean over
    scenes. The G-buffer takes as many samples as in the results, or `gbuffer_ms`. `device` names
    the device whose times are used, where the results have several. `left_out` are sentences about
    rows that were not considered; `plugins` are options that suggested commands need. Times of
    inference have intervals, which say what else the answer could be. Raises ReportError if no
    method fits or has times, or if rows cannot be compared; `strict`: also if the times leave the
    answer open.
    """
    rows, device = select_device(charge_gbuffer(results, gbuffer_ms), device)
    check_comparable(rows)
    scores = Scores(rows, metric, device)
    check_ranks(scores)
    curves = curves_of(scores)
    if given:
        times = given.inference_ms
        unknown = [curve.method for curve in curves if curve.method not in times]
        left_out = [*left_out, *(f"{name} has no time in the cost profile" for name in unknown)]
        curves = [_retime(curve, times[curve.method]) for curve in curves if curve.method in times]
        if not curves:
            raise ReportError(
                f"the cost profile has times of {', '.join(times) or 'no method'}, and the results "
                f"have {', '.join(unknown)}; time these with rlbench speed --as-cost"
            )
    if not curves:
        raise ReportError(
            f"no method has {metric} and times on every scene; found: "
            f"{'; '.join(methods_without_curve(scores, []))}. Measure with rlbench run"
        )
    source = given.device if given else _timed_on(rows) or device
    claimed = set(methods_from_elsewhere(rows))
    competing, unit = denoisers(curves), scores.column_text("unit")
    ranked = _candidates(competing, sample_ms, frame_ms, unit, claimed)
    others = [curve for curve in curves if curve not in competing]
    undenoised = next(iter(_candidates(others, sample_ms, frame_ms, unit, claimed)), None)
    timed = rows[rows["metric"].isin(INFERENCE) & rows["method"].isin([c.method for c in curves])]
    sizes = (given.size,) if given else tuple(sorted(set(timed["size"]) - {""}))
    if not ranked:
        where = f"{source or 'an unnamed device'} at {', '.join(sizes) or 'an unnamed size'}"
        raise _nothing_fits(competing, sample_ms, frame_ms, where, undenoised, unit, plugins)
    inference = [line for line in scores.uncertain_times if line.startswith("inference_ms")]
    could_win, doubt = _find_doubts(competing, ranked[0].method, sample_ms, frame_ms)
    if strict and could_win:
        raise ReportError(
            f"--strict: times are too uncertain to name a winner: {'; '.join(inference)}. Measure "
            "them again when the machine is quiet: rlbench run --times uncertain"
        )
    return Decision(
        sample_ms=sample_ms,
        frame_ms=frame_ms,
        metric=metric,
        unit=unit,
        convention=scores.convention,
        direction=scores.direction,
        candidates=ranked,
        could_win=could_win,
        uncertainty=doubt,
        undenoised=undenoised,
        changes=tuple(_break_evens(competing, sample_ms, frame_ms)),
        scenes=tuple(sorted(set(scores.scene_means["scene"]))),
        inference_device=source,
        device_mixes=() if given else tuple(scores.device_mixes),
        image_sizes=sizes,
        measured_sample_ms=given.sample_ms if given else measured_sample_ms(scores),
        measured_sample_source=given.source if given else scores.cost_source,
        notes=(
            *left_out,
            *methods_without_curve(scores, curves),
            *(f"uncertain: {line}" for line in inference if not given),
            *([] if given else remarks(timed)),
        ),
    )


def _timed_on(rows: pd.DataFrame) -> str:
    """The devices that inference is of, which a cost profile may name; empty if not stated."""
    conventions = rows.loc[rows["metric"] == "frame_ms", "convention"]
    found = conventions.str.extract(r"inference on (.*?); samples", expand=False).dropna()
    return "; ".join(sorted(set(found)))


def check_ranks(scores: Scores) -> None:
    """Raise ReportError if the metric has no values, or none that rank methods."""
    if scores.measured.empty or scores.direction not in ("higher", "lower"):
        rows = scores.rows
        ranked = rows[rows["value"].notna() & (rows["direction"] != "") & (rows["unit"] != "ms")]
        raise ReportError(
            f"metric '{scores.metric}' was requested, and the results have no values of it that "
            f"rank methods; metrics that do: {', '.join(sorted(set(ranked['metric']))) or 'none'}"
        )


def _retime(curve: Curve, inference_ms: float) -> Curve:
    times = np.full_like(curve.fixed_ms, inference_ms)
    return replace(curve, fixed_ms=times, late_ms=times, low_ms=times, high_ms=times)


def _candidates(
    curves: Sequence[Curve], sample_ms: float, frame_ms: float, unit: str, claimed: Set[str]
) -> tuple[Candidate, ...]:
    """Every method that fits the deadline, the best first; empty if none does."""
    if not curves:
        return ()
    at = np.array([sample_ms]), np.array([frame_ms])
    winners = find_winners(curves, *at)
    spp = winners.spp[:, 0]
    ranked = [int(index) for index in winners.order[:, 0] if not math.isnan(spp[index])]
    best = [curves[index].units_at(spp[index]) for index in ranked[:1]]
    found = []
    for index in ranked:
        curve, units = curves[index], curves[index].units_at(spp[index])
        gap = UNKNOWN if index == ranked[0] else interval_of(units - best[0])
        frame = float(curve.frame_ms_at(spp[index], sample_ms))
        low, high = (float(curve.at_end(e).frame_ms_at(spp[index], sample_ms)) for e in ENDS)
        sampling = float(np.interp(spp[index], curve.spp, curve.samples)) * sample_ms
        found.append(
            Candidate(
                method=curve.method,
                spp=float(spp[index]),
                value=interval_of(units),
                frame_ms=frame,
                gbuffer_ms=(gbuffer := float(curve.gbuffer_ms_at(np.array(sample_ms)))),
                inference_ms=frame - gbuffer - sampling,
                sampling_ms=sampling,
                is_largest_budget=bool(spp[index] == curve.spp[-1]),
                low_ms=low,
                high_ms=high,
                is_claimed=curve.method in claimed,
                difference=gap,
                verdict=name_verdict(gap, unit, curve.direction),
            )
        )
    p_holm = holm([candidate.difference.p_value for candidate in found])
    return tuple(replace(c, p_holm=float(p)) for c, p in zip(found, p_holm, strict=True))


def _find_doubts(
    curves: Sequence[Curve], winner: str, sample_ms: float, frame_ms: float
) -> tuple[tuple[str, ...], float]:
    """The other methods that could win, and the largest uncertainty of their and its times."""
    possible = find_possible_winners(curves, np.array([sample_ms]), np.array([frame_ms]))[:, 0]
    involved = [c for c, may in zip(curves, possible, strict=True) if may or c.method == winner]
    others = tuple(curve.method for curve in involved if curve.method != winner)
    return others, max(curve.uncertainty(sample_ms) for curve in involved)


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


def _nothing_fits(
    curves: Sequence[Curve],
    sample_ms: float,
    frame_ms: float,
    where: str,
    undenoised: Candidate | None,
    unit: str,
    plugins: str,
) -> ReportError:
    """What did not fit, what the times are of, and how to get times of another device."""
    needed, low, method, spp = min(
        (float(time), float(low), curve.method, float(spp))
        for curve in curves
        for spp, time, low in zip(
            curve.spp,
            curve.frame_ms(sample_ms),
            curve.at_end("low").frame_ms(sample_ms),
            strict=True,
        )
    )
    doubt = f" (uncertain: {low:.3g} ms at least)" * (low < needed)
    raw = ""
    if undenoised:
        score = f"{undenoised.value.mean:.4g} {unit}".rstrip()
        raw = f" Without a denoiser, {undenoised.method} at {undenoised.spp:.3g} spp has {score}."
    names = sorted({without_label(curve.method) for curve in curves})
    named = "all" if len(names) > NAMED else ",".join(names)
    return ReportError(
        f"no denoiser with a time fits {frame_ms:g} ms at {sample_ms:g} ms a sample; these are "
        f"times of {where}. The cheapest, {method} at {spp:g} spp, needs {needed:.3g} ms{doubt}."
        f"{raw} For times of your device and size, run there: rlbench speed -m {named}{plugins} "
        f"--device cuda --sizes 1080p --as-cost gpu.toml --sample-ms {sample_ms:g}; then decide "
        "with --cost gpu.toml. Or raise --frame-ms"
    )
