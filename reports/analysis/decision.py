"""The answer for one renderer: method and budget, how sure, and what would change it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from reports.analysis.curves import Curve
from reports.analysis.intervals import BOOTSTRAP_SAMPLES, UNKNOWN, Interval, interval_of
from reports.analysis.multiplicity import holm
from reports.analysis.verdicts import name_verdict
from reports.analysis.winner import (
    NOTHING,
    Switch,
    find_switches,
    find_winners,
    meeting_costs,
    meeting_deadlines,
)

__all__ = ["BreakEven", "Candidate", "Decision", "break_evens", "candidates"]


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


def candidates(
    curves: Sequence[Curve],
    sample_ms: float,
    frame_ms: float,
    unit: str = "dB",
    seed: int = 0,
    draws: int = BOOTSTRAP_SAMPLES,
) -> tuple[Candidate, ...]:
    """Every method that fits the deadline `frame_ms`, the best first; empty if none does."""
    winners = find_winners(curves, np.array([sample_ms]), np.array([frame_ms]))
    spp = winners.spp[:, 0]
    ranked = [int(index) for index in winners.order[:, 0] if not math.isnan(spp[index])]
    best = [curves[index].units_at(spp[index]) for index in ranked[:1]]
    result = []
    direction = curves[0].direction if curves else ""
    for index in ranked:
        curve, units = curves[index], curves[index].units_at(spp[index])
        gap = UNKNOWN
        if index != ranked[0]:
            gap = interval_of(units - best[0], seed, draws)
        frame = float(curve.frame_ms_at(spp[index], sample_ms))
        sampling = float(np.interp(spp[index], curve.spp, curve.samples)) * sample_ms
        result.append(
            Candidate(
                method=curve.method,
                spp=float(spp[index]),
                value=interval_of(units, seed, draws),
                frame_ms=frame,
                inference_ms=frame - sampling,
                sampling_ms=sampling,
                is_largest_budget=bool(spp[index] == curve.spp[-1]),
                difference=gap,
                verdict=name_verdict(gap, unit, direction),
            )
        )
    p_holm = holm([candidate.difference.p_value for candidate in result])
    return tuple(replace(c, p_holm=float(p)) for c, p in zip(result, p_holm, strict=True))


def break_evens(curves: Sequence[Curve], sample_ms: float, frame_ms: float) -> list[BreakEven]:
    """The nearest lower and higher cost of a sample, and deadline, at which another method wins."""

    def winner_by_cost(costs: np.ndarray) -> np.ndarray:
        return find_winners(curves, costs, np.full_like(costs, frame_ms)).first

    def winner_by_deadline(deadlines: np.ndarray) -> np.ndarray:
        return find_winners(curves, np.full_like(deadlines, sample_ms), deadlines).first

    costs = [*meeting_costs(curves, frame_ms), sample_ms]
    deadlines = [*meeting_deadlines(curves, sample_ms), frame_ms]
    by_cost = find_switches(winner_by_cost, costs)
    by_deadline = find_switches(winner_by_deadline, deadlines)
    return [
        *_nearest("sample_ms", by_cost, sample_ms, curves),
        *_nearest("frame_ms", by_deadline, frame_ms, curves),
    ]


def _nearest(
    changed: str, switches: Sequence[Switch], now: float, curves: Sequence[Curve]
) -> list[BreakEven]:
    below = [switch for switch in switches if switch.at <= now][-1:]
    above = [switch for switch in switches if switch.at > now][:1]
    changes = []
    for direction, found in (("lower", below), ("higher", above)):
        if not found:
            changes.append(BreakEven(changed, direction, None, None))
            continue
        index = found[0].before if direction == "lower" else found[0].after
        method = None if index == NOTHING else curves[index].method
        changes.append(BreakEven(changed, direction, found[0].at, method))
    return changes
