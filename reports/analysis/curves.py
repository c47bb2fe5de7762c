"""A method between its measured budgets: score and frame time at any spp, and who wins a deadline.

Scores are interpolated linearly in log spp, so that a curve rises wherever its measured points
rise; times are interpolated linearly in spp. Nothing is extrapolated, and there is nothing between
a budget of 0 spp and the next one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from reports.analysis.rows import GIVEN_GBUFFER, family_of
from reports.analysis.scores import ENDS, INFERENCE, Scores, mean_over_scenes
from rlbench.benchmark.results import WIDE, uncertainty

Numbers = NDArray[np.float64]
TINY = 1e-9  # stands for a budget of 0 spp, whose logarithm would be infinite
UNDENOISED = ("mean", "restir")  # families whose images are what was sampled
NOTHING = -1  # in place of a method where none fits
STEPS = 8  # places that are examined between two meeting points
BISECTIONS = 60  # more than a double has bits


@dataclass(frozen=True, eq=False)
class Curve:
    """The scores and times of one method at its measured budgets, and between them."""

    method: str
    spp: Numbers  # [budgets], ascending
    units: Numbers  # [budgets units], score of each scene, or of each clip of the only scene
    fixed_ms: Numbers  # [budgets], plan + allocate + denoise, mean over scenes
    samples: Numbers  # [budgets], time of the drawn samples of a pixel, in path samples
    late_ms: Numbers  # [budgets], as fixed_ms, but p95
    low_ms: Numbers  # [budgets], low end of the interval of fixed_ms; fixed_ms where it is narrow
    high_ms: Numbers  # [budgets], high end, likewise
    sign: int  # 1 where high scores are better, -1 where low ones are
    gbuffer_samples: float = 0.0  # time of the G-buffer, in path samples
    gbuffer_ms: float = 0.0  # in place of it, a time that does not depend on that of a sample

    def at_end(self, end: str) -> Curve:
        """The curve with times at the `low` or `high` end of their intervals."""
        fixed = self.low_ms if end == "low" else self.high_ms
        return replace(self, fixed_ms=fixed, late_ms=self.late_ms + fixed - self.fixed_ms)

    def uncertainty(self, sample_ms: float | Numbers) -> float:
        """The largest `uncertainty` of the frame times, from that of inference."""
        ends = (each.frame_ms(sample_ms).tolist() for each in (self, *map(self.at_end, ENDS)))
        return max(uncertainty(*times) for times in zip(*ends, strict=True))

    @property
    def direction(self) -> str:
        """`higher` or `lower`, whichever is better."""
        return "higher" if self.sign > 0 else "lower"

    def frame_ms(self, sample_ms: float | Numbers, late: bool = False) -> Numbers:
        """Frame time [..., budgets] at each measured budget; `late`: p95 of inference."""
        fixed = self.late_ms if late else self.fixed_ms
        sample = np.asarray(sample_ms, float)[..., None]
        times: Numbers = self.gbuffer_ms_at(sample) + fixed + self.samples * sample
        return times

    def gbuffer_ms_at(self, sample_ms: Numbers) -> Numbers:
        """Time of the G-buffer where a path sample of each pixel costs `sample_ms`."""
        return self.gbuffer_ms + self.gbuffer_samples * sample_ms

    def frame_ms_at(self, spp: Numbers, sample_ms: float) -> Numbers:
        """Frame time at budgets between the smallest and the largest measured one."""
        return self._inside(np.interp(spp, self.spp, self.frame_ms(sample_ms)), spp)

    def units_at(self, spp: Numbers) -> Numbers:
        """Scores [..., units] of scenes or clips at any budgets; nan outside of the measured."""
        columns = [self._interpolate(spp, scores) for scores in self.units.T]
        return np.stack(columns, axis=-1)

    def value_at(self, spp: Numbers) -> Numbers:
        """The mean score over scenes at any budgets; nan outside of the measured."""
        return self._interpolate(spp, self.units.mean(axis=1))

    def best_spp(self, sample_ms: Numbers, deadline_ms: Numbers, late: bool = False) -> Numbers:
        """The budgets [n] with the best score whose frame time is within the deadline; nan: none.

        On a piece between two measured budgets time is linear and the score monotone, so that the
        best is at a measured budget, or where a piece meets the deadline.
        """
        times = self.frame_ms(sample_ms, late)  # n budgets
        limit = np.asarray(deadline_ms, float)[..., None]
        fits = times <= limit
        budgets = np.where(fits, self.spp, np.nan)
        start, end = times[..., :-1], times[..., 1:]
        with np.errstate(divide="ignore", invalid="ignore"):
            share = (limit - start) / (end - start)
        meets = (fits[..., :-1] != fits[..., 1:]) & (self.spp[:-1] > 0)
        meeting = np.where(meets, self.spp[:-1] + share * np.diff(self.spp), np.nan)
        candidates = np.concatenate([budgets, meeting], axis=-1)
        scores = self.sign * self.value_at(candidates)
        best = np.argmax(np.where(np.isnan(scores), -np.inf, scores), axis=-1)
        return np.take_along_axis(candidates, best[..., None], axis=-1)[..., 0]

    def _interpolate(self, spp: Numbers, scores: Numbers) -> Numbers:
        logs = np.log(np.maximum(self.spp, TINY))
        return self._inside(np.interp(np.log(np.maximum(spp, TINY)), logs, scores), spp)

    def _inside(self, values: Numbers, spp: Numbers) -> Numbers:
        return np.where((spp >= self.spp[0]) & (spp <= self.spp[-1]), values, np.nan)


def curves_of(scores: Scores) -> list[Curve]:
    """The curve of each method, by name, over the budgets with scores and times on every scene.

    An interval of inference that is narrow changes no answer: its ends are the time itself.
    """
    points = scores.points.assign(**_in_path_samples(scores.points))
    budgets = mean_over_scenes(points).dropna(subset=["inference_ms", "samples"])
    unit = "scene" if scores.scene_means["scene"].nunique() > 1 else "clip"
    means = scores.scene_means if unit == "scene" else scores.clip_means
    units = means.pivot(index=["method", "target_spp"], columns=unit, values="value")
    sign = -1 if scores.direction == "lower" else 1
    columns = ["target_spp", "inference_ms", "samples", "inference_p95_ms"]
    ends = ["inference_low_ms", "inference_high_ms"]
    is_given = (scores.rows["convention"] == GIVEN_GBUFFER).any()
    curves = []
    for method, rows in budgets.sort_values("target_spp").groupby("method"):
        table = units.loc[[(method, spp) for spp in rows["target_spp"]]].to_numpy(float)
        spp, fixed, samples, late = (rows[name].to_numpy(float) for name in columns)
        low, high = (rows[name].to_numpy(float) for name in ends)
        is_wide = [uncertainty(*times) > WIDE for times in zip(fixed, low, high, strict=True)]
        low, high = (np.where(is_wide, end, fixed) for end in (low, high))
        gbuffer = rows["gbuffer_ms" if is_given else "gbuffer_samples"].fillna(0.0).mean()
        per_sample, per_frame = (0.0, float(gbuffer)) if is_given else (float(gbuffer), 0.0)
        times = fixed, samples, late, low, high
        curves.append(Curve(str(method), spp, table, *times, sign, per_sample, per_frame))
    return curves


def denoisers(curves: Sequence[Curve]) -> list[Curve]:
    """The curves that may win: those of denoisers. All of them where none is a denoiser."""
    found = [curve for curve in curves if family_of(curve.method) not in UNDENOISED]
    return found or list(curves)


def methods_without_curve(scores: Scores, curves: Iterable[Curve]) -> list[str]:
    """Sentences about the methods that have scores and no curve, each with what it lacks."""
    timed = scores.points.dropna(subset=INFERENCE)
    complete = set(scores.overall["method"])
    reasons = {
        method: f"{method} has no {scores.metric} on every scene and frame at any budget"
        if method not in complete
        else f"{method} has no time on every scene"
        if method not in set(timed["method"])
        else f"{method} has no cost of its samples on every scene"
        for method in set(scores.measured["method"]) - {curve.method for curve in curves}
    }
    return [reasons[method] for method in sorted(reasons)]


def measured_sample_ms(scores: Scores) -> float:
    """Time of one path sample per pixel in the results, mean over scenes, ms; nan without one."""
    return float(_path_sample_ms(scores.points).mean())


def _path_sample_ms(points: pd.DataFrame) -> pd.Series[float]:
    """Time of a path sample by scene: that of its cheapest samples, since pools add to paths."""
    return points.groupby("scene")["sample_ms"].min()


def _in_path_samples(points: pd.DataFrame) -> dict[str, pd.Series[float]]:
    """Times of the drawn samples and of the G-buffer, in path samples of an average scene.

    Results without any cost of a sample count all samples alike.
    """
    path = _path_sample_ms(points)
    if path.isna().all():
        return {"samples": points["mean_spp"], "gbuffer_samples": points["gbuffer_ms"] * 0.0}
    parts = {"samples": points["sampling_ms"], "gbuffer_samples": points["gbuffer_ms"]}
    return {name: times / float(path.mean()) for name, times in parts.items()}


@dataclass(frozen=True, eq=False)
class Winners:
    """For each of n pairs of deadline and cost: the methods that fit, the best one first."""

    order: NDArray[np.intp]  # [methods n], indices of the curves, best first
    spp: Numbers  # [methods n], best budget of each curve; nan where it does not fit
    values: Numbers  # [methods n], score at that budget

    @property
    def first(self) -> NDArray[np.intp]:
        """Index of the winner's curve, [n], or NOTHING."""
        return self._place(0)

    @property
    def second(self) -> NDArray[np.intp]:
        """Index of the runner-up's curve, [n], or NOTHING."""
        return self._place(1)

    def _place(self, rank: int) -> NDArray[np.intp]:
        if rank >= len(self.order):
            return np.full(self.order.shape[1], NOTHING)
        index = self.order[rank]
        fits = ~np.isnan(np.take_along_axis(self.spp, index[None], axis=0)[0])
        return np.where(fits, index, NOTHING)


@dataclass(frozen=True)
class Switch:
    """A place where the label changes from `before` to `after` as x grows."""

    at: float
    before: int
    after: int


def find_winners(curves: Sequence[Curve], sample_ms: Numbers, deadline_ms: Numbers) -> Winners:
    """Order the curves at each pair of cost [n] and deadline [n]; equal scores by their order."""
    spp = np.stack([curve.best_spp(sample_ms, deadline_ms) for curve in curves])
    values = np.stack([curve.value_at(s) for curve, s in zip(curves, spp, strict=True)])
    scores = np.where(np.isnan(values), -np.inf, curves[0].sign * values)
    return Winners(np.argsort(-scores, axis=0, kind="stable"), spp, values)


def find_possible_winners(
    curves: Sequence[Curve], sample_ms: Numbers, deadline_ms: Numbers
) -> NDArray[np.bool_]:
    """The curves that would win, [methods n], if times were at some place of their intervals.

    A curve may win if its score at the low end of its time is the best, while all others are at the
    high end of theirs. Where all intervals are narrow, that is the winner alone.
    """
    ends = []
    for end in ENDS:
        at_end = [curve.at_end(end) for curve in curves]
        winners = find_winners(at_end, sample_ms, deadline_ms)
        values = curves[0].sign * winners.values
        ends.append(np.where(np.isnan(values), -np.inf, values))
    best_case, worst_case = ends
    possible = np.zeros_like(best_case, bool)
    for index in range(len(curves)):
        others = np.delete(worst_case, index, axis=0)
        rival = others.max(axis=0, initial=-np.inf)
        possible[index] = np.isfinite(best_case[index]) & (best_case[index] >= rival)
    return possible


def find_switches(
    label: Callable[[Numbers], NDArray[np.intp]], points: Sequence[float]
) -> list[Switch]:
    """The places where a label of x > 0 changes, from the smallest to the largest of `points`.

    `points` are the places where the label may begin to behave differently (`meeting_deadlines`). A
    change and its reversal within an eighth of the way between two of them is not seen.
    """
    known = np.unique([x for x in points if 0 < x < np.inf])
    if len(known) == 0:
        return []
    inner = np.linspace(np.log(known[:-1]), np.log(known[1:]), STEPS, endpoint=False)
    x = np.unique(np.concatenate([np.exp(inner).ravel(), known, known[:1] / 2, known[-1:] * 2]))
    labels = label(x)
    (places,) = np.nonzero(labels[:-1] != labels[1:])
    low, high, before = x[places], x[places + 1], labels[places]
    for _ in range(BISECTIONS if len(places) else 0):
        middle = (low + high) / 2
        is_before = label(middle) == before
        low, high = np.where(is_before, middle, low), np.where(is_before, high, middle)
    after = label(high) if len(places) else before
    parts = zip(high, before, after, strict=True)
    return [Switch(float(at), int(first), int(second)) for at, first, second in parts]


def meeting_deadlines(curves: Sequence[Curve], sample_ms: float) -> list[float]:
    """Deadlines that measured budgets just meet at this cost of a sample, ms."""
    return [float(time) for curve in curves for time in curve.frame_ms(sample_ms)]


def meeting_costs(curves: Sequence[Curve], deadline_ms: float) -> list[float]:
    """Costs of a sample at which measured budgets just meet this deadline, ms."""
    with np.errstate(divide="ignore", invalid="ignore"):
        costs = [(deadline_ms - curve.fixed_ms) / curve.samples for curve in curves]
    return [float(cost) for part in costs for cost in part]
