"""Differences between methods: their verdicts, Holm's correction of a page, and who is best."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from reports.analysis.intervals import (
    FRAME,
    INTERVAL_NOTE,
    LEVEL,
    POWER,
    UNKNOWN,
    Interval,
    intervals_of,
    mean_with_interval,
    pair,
    smallest_resolvable,
)
from reports.analysis.scores import Scores, mean_over_scenes
from rlbench.benchmark.results import WIDE, interval_columns, uncertainty

ALL_SCENES = "all"  # in the column `scene` of means over scenes
TIE_DB = 0.1  # of PSNR; a smaller difference matters to nobody
LEADS, TRAILS, TIE, NOT_RESOLVED = "leads", "trails", "tie", "not resolved"
HOLM_MARK = "†"  # after a lead that the correction takes away
# the scope of the correction, everywhere: a reader sees all that it corrects for
HOLM_SCOPE = "all differences shown together"
VERDICT_NOTE = (
    f"Brackets: {INTERVAL_NOTE}. Tie: the interval lies within +-{TIE_DB:g} dB. Not resolved: "
    f"the interval is wider and includes zero. Otherwise one method leads; {HOLM_MARK} marks a "
    f"lead that Holm's correction for {HOLM_SCOPE} takes away."
)
RANK_COLUMNS = [
    "metric", "scene", "target_spp", "method", "mean", "difference", "low", "high", "best",
    "verdict", "p_value", "unit", "resolvable", "clips", "frames",
]  # fmt: skip
VARIANT_COLUMNS = [
    "method", "base", "target_spp", "difference", "low", "high", "verdict", "p_value", "unit",
    "resolvable", "frame_ms", "frame_range_ms", "pairs", "unpaired", "units",
]  # fmt: skip


def name_verdict(gap: Interval, unit: str, direction: str = "higher") -> str:
    """The verdict on the method whose score minus that of another is `gap`; "" without an interval.

    The printed 95 % interval decides all. Within +-0.1 dB it is a tie: two one-sided tests at 2.5 %
    reject both larger differences (Schuirmann 1987; Lakens 2017), as strictly as a lead is tested.
    Other units have no margin, so no ties. `direction` says whether "higher" or "lower" is better.

    >>> name_verdict(Interval(0.2, -0.1, 0.5, 4), "dB")
    'not resolved'
    >>> name_verdict(Interval(0.2, 0.1, 0.3, 4), "", "lower")
    'trails'
    """
    if not gap.is_known:
        return ""
    if unit == "dB" and gap.is_within(TIE_DB):
        return TIE
    if not gap.excludes_zero:
        return NOT_RESOLVED
    return LEADS if (gap.mean > 0) == (direction != "lower") else TRAILS


def describe_difference(gap: Interval, unit: str, direction: str = "higher") -> str:
    """The verdict with its figures, for sentences.

    >>> describe_difference(Interval(-0.2, -0.3, -0.1, 4), "dB")
    'trails by 0.20 dB [0.10, 0.30]'
    >>> describe_difference(Interval(0.2, -0.1, 0.5, 4), "dB")
    'not resolved, +0.20 dB [-0.10, +0.50]'
    >>> describe_difference(Interval(0.2, float("nan"), float("nan"), 1), "dB")
    '+0.20 dB, no interval: one clip'
    """
    digits = ".2f" if unit in ("dB", "ms") else ".3g"
    verdict = name_verdict(gap, unit, direction)
    ends = f"[{gap.low:+{digits}}, {gap.high:+{digits}}]"
    signed = f"{gap.mean:+{digits}} {unit}".strip()
    if not verdict:
        return f"{signed}, no interval: one clip"
    if verdict in (TIE, NOT_RESOLVED):
        return f"{verdict}, {signed} {ends}"
    low, high = sorted((abs(gap.low), abs(gap.high)))
    size = f"{abs(gap.mean):{digits}} {unit}".strip()
    return f"{verdict} by {size} [{low:{digits}}, {high:{digits}}]"


def difference_columns(
    gap: Interval, unit: str = "dB", direction: str = "higher"
) -> dict[str, object]:
    """A difference as columns of a record: its interval, verdict, p and what could be resolved."""
    return {
        "difference": gap.mean,
        "low": gap.low,
        "high": gap.high,
        "verdict": name_verdict(gap, unit, direction),
        "p_value": gap.p_value,
        "unit": unit,
        "resolvable": smallest_resolvable(gap.deviation, gap.units),
    }


def holm(p_values: Sequence[float]) -> NDArray[np.float64]:
    """Adjusted p-values [n] of Holm 1979 (A Simple Sequentially Rejective Multiple Test Procedure).

    The smallest is multiplied by n, the next by n - 1, and so on; none is below an earlier one, nor
    above 1. A nan is not a comparison and stays nan.

    >>> holm([0.01, 0.04, 0.03]).round(4).tolist()
    [0.03, 0.06, 0.06]
    """
    p = np.asarray(p_values, float)
    adjusted = np.full_like(p, np.nan)
    order = np.argsort(p)[: np.count_nonzero(~np.isnan(p))]
    factors = np.arange(len(order), 0, -1)
    adjusted[order] = np.maximum.accumulate(np.minimum(p[order] * factors, 1.0))
    return adjusted


def correct_by_holm(records: pd.DataFrame) -> pd.DataFrame:
    """All records of a page, with `p_holm`, and `mark` where the correction takes a lead away."""
    p_holm = holm(list(records["p_value"]))
    mark = [holm_mark(*each) for each in zip(records["verdict"], p_holm, strict=True)]
    return records.assign(p_holm=p_holm, mark=mark)


def holm_mark(verdict: str, p_holm: float) -> str:
    """The mark of a lead that the correction takes away; empty for others."""
    return HOLM_MARK if verdict in (LEADS, TRAILS) and p_holm > 1 - LEVEL else ""


def difference_notes(records: pd.DataFrame) -> list[str]:
    """What the differences of a page resolve, after `correct_by_holm`; empty without any."""
    compared = records[records["p_value"].notna()]
    if compared.empty:
        return []
    leads = compared[compared["verdict"].isin([LEADS, TRAILS])]
    kept = leads[leads["mark"] == ""]
    lines = [
        f"Holm's correction for the {len(compared)} differences of this page keeps {len(kept)} of "
        f"{len(leads)} leads at 5 % over all (p of the paired t-test); {HOLM_MARK} marks the others"
    ]
    sizes = records.loc[records["unit"] == "dB", "resolvable"].dropna()
    if len(sizes):
        lines.append(
            f"With power {POWER * 100:.0f} %, these clips resolve differences from "
            f"{sizes.median():.2f} dB on (median; {sizes.min():.2f} to {sizes.max():.2f} dB, "
            "depending on the pair of methods)"
        )
    return lines


def subtract_base(scores: Scores, base: str, methods: Sequence[str]) -> pd.DataFrame:
    """Score and frame time of each of `methods` minus those of `base`, per budget.

    The two scores of a pair have scene, clip, frame, budget and seed in common; `low` and `high`
    are the interval (nan with one clip); `p_holm` is corrected over all differences. `frame_ms` is
    the mean difference over the scenes that both have, nan where either has no time, and
    `frame_range_ms` half of the range of it; 0 where both intervals are narrow.
    """
    parts = {key: part for key, part in scores.measured.groupby(["method", "target_spp"])}
    records = []
    for method in methods:
        for spp in sorted(set(scores.measured["target_spp"])):
            if (method, spp) not in parts or (base, spp) not in parts:
                continue
            variant, main = parts[method, spp], parts[base, spp]
            pairs = pair(variant, main, (*FRAME, "seed"))
            gap = mean_with_interval(pairs)
            points = scores.points[scores.points["target_spp"] == spp].set_index("scene")
            times, other = (points[points["method"] == name] for name in (method, base))
            records.append(
                {
                    **{"method": method, "base": base, "target_spp": spp},
                    **difference_columns(gap),
                    "frame_ms": float((times["frame_ms"] - other["frame_ms"]).mean()),
                    "frame_range_ms": _range_of_difference(times, other),
                    "pairs": len(pairs),
                    "unpaired": len(variant) + len(main) - 2 * len(pairs),
                    "units": gap.units,
                }
            )
    return correct_by_holm(pd.DataFrame(records, columns=VARIANT_COLUMNS))


def _range_of_difference(times: pd.DataFrame, other: pd.DataFrame) -> float:
    """Half of the range of a difference of mean frame times; 0 where both intervals are narrow."""
    ends = [
        [float(part[column].mean()) for column in interval_columns("frame")]
        for part in (times, other)
    ]
    if all(uncertainty(*each) <= WIDE for each in ends):
        return 0.0
    return sum(high - low for _, low, high in ends) / 2


def rank_methods(scores: Scores) -> pd.DataFrame:
    """A row for each method, budget and scene; scene "all" is the mean over scenes.

    `difference` is the mean of the paired differences to the best method at that budget, `low` and
    `high` its interval (nan with one scene and clip), `verdict` that of `name_verdict`, and
    `resolvable` the smallest difference that such a pair can resolve. No method is best if the
    metric has no direction. In "all", methods that lack a scene are left out.
    """
    frames = scores.per_frame
    complete = mean_over_scenes(scores.scene_means)[["method", "target_spp"]]
    parts = [(ALL_SCENES, frames.merge(complete, on=["method", "target_spp"]))]
    parts += [(str(scene), rows) for scene, rows in frames.groupby("scene")]
    records = []
    for scene, rows in parts:
        for spp, methods in rows.groupby("target_spp"):
            keys = {"metric": scores.metric, "scene": scene, "target_spp": spp}
            records += [keys | row for row in _rank(methods, scores)]
    return pd.DataFrame(records, columns=RANK_COLUMNS)


def _rank(rows: pd.DataFrame, scores: Scores) -> list[dict[str, object]]:
    frames = rows.pivot(index=list(FRAME), columns="method", values="value")
    clip_means = frames.groupby(level=["scene", "clip"]).mean()
    scene_means = clip_means.groupby(level="scene").mean()
    means, units = scene_means.mean(), scene_means if len(scene_means) > 1 else clip_means
    sign = {"higher": 1, "lower": -1}.get(scores.direction, 0)
    best = str((sign * means).idxmax()) if sign else ""
    # all have the same frames, so the mean of gaps is the gap
    gaps = units.sub(units[best], axis=0) if best else units * math.nan
    intervals = intervals_of(gaps.to_numpy(np.float64))
    clips, unit = rows.groupby("method")["clip"].nunique(), scores.column_text("unit")
    return [
        {"method": method, "mean": means[method]}
        | difference_columns(UNKNOWN if method == best else gap, unit, scores.direction)
        | {"best": bool(best) and means[method] == means[best]}
        | {"clips": int(clips[method]), "frames": int(frames[method].count())}
        for method, gap in zip(map(str, frames.columns), intervals, strict=True)
    ]
