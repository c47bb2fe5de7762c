"""The best method at each budget, the distance of the others to it, and what is not resolved."""

from __future__ import annotations

import math

import pandas as pd

from reports.analysis.aggregate import Scores, mean_over_scenes
from reports.analysis.intervals import BOOTSTRAP_SAMPLES, Interval, mean_with_interval, pair

__all__ = ["ALL_SCENES", "TIE_DB", "name_verdict", "rank_methods"]

TIE_DB = 0.1  # of PSNR; a smaller difference matters to nobody
ALL_SCENES = "all"  # in the column `scene` of means over scenes
COLUMNS = (
    "metric", "scene", "target_spp", "method", "mean", "difference", "low", "high", "best",
    "verdict", "clips", "frames",
)  # fmt: skip


def rank_methods(scores: Scores, seed: int = 0, draws: int = BOOTSTRAP_SAMPLES) -> pd.DataFrame:
    """A row for each method, budget and scene; scene "all" is the mean over scenes.

    `difference` is the mean of the paired differences to the best method at that budget, `low` and
    `high` its interval (nan with one scene and clip). `verdict` is "tie" where the interval lies
    within +-0.1 dB, else "not resolved" where it includes zero, else "". No method is best if the
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
            records += [keys | row for row in _rank(methods, scores, seed, draws)]
    return pd.DataFrame(records, columns=list(COLUMNS))


def _rank(rows: pd.DataFrame, scores: Scores, seed: int, draws: int) -> list[dict[str, object]]:
    frames = {str(method): part for method, part in rows.groupby("method")}
    means = {method: _mean(part) for method, part in frames.items()}
    sign = {"higher": 1, "lower": -1}.get(scores.direction, 0)
    best = max(means, key=lambda method: sign * means[method]) if sign else ""
    unit = scores.column_text("unit")
    ranked = []
    for method, part in frames.items():
        difference = dict.fromkeys(("difference", "low", "high"), math.nan)
        verdict = ""
        if best and method != best:
            gap = mean_with_interval(pair(part, frames[best]), seed, draws)
            difference = {"difference": gap.mean, "low": gap.low, "high": gap.high}
            verdict = name_verdict(gap, unit)
        ranked.append(
            {"method": method, "mean": means[method], **difference, "verdict": verdict}
            | {"best": bool(best) and means[method] == means[best]}
            | {"clips": part["clip"].nunique(), "frames": len(part)}
        )
    return ranked


def name_verdict(gap: Interval, unit: str) -> str:
    """`tie` if the interval lies within +-0.1 dB, else `not resolved` if it includes zero, else "".

    >>> name_verdict(Interval(0.2, -0.1, 0.5, 4), "dB")
    'not resolved'
    """
    if unit == "dB" and gap.is_tie(TIE_DB):
        return "tie"
    return "" if gap.is_resolved else "not resolved"


def _mean(frames: pd.DataFrame) -> float:
    """Mean over the frames of a clip, then over the clips of a scene, then over scenes."""
    clips = frames.groupby(["scene", "clip"])["value"].mean()
    return float(clips.groupby("scene").mean().mean())
