"""The best method at each budget, the distance of the others to it, and what is not resolved."""

from __future__ import annotations

import math

import numpy as np
import pandas as pd

from reports.analysis.aggregate import Scores, mean_over_scenes
from reports.analysis.intervals import BOOTSTRAP_SAMPLES, FRAME, UNKNOWN, intervals_of
from reports.analysis.multiplicity import difference_columns

__all__ = ["ALL_SCENES", "rank_methods"]

ALL_SCENES = "all"  # in the column `scene` of means over scenes
COLUMNS = (
    "metric", "scene", "target_spp", "method", "mean", "difference", "low", "high", "best",
    "verdict", "p_value", "unit", "resolvable", "clips", "frames",
)  # fmt: skip


def rank_methods(scores: Scores, seed: int = 0, draws: int = BOOTSTRAP_SAMPLES) -> pd.DataFrame:
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
            records += [keys | row for row in _rank(methods, scores, seed, draws)]
    return pd.DataFrame(records, columns=list(COLUMNS))


def _rank(rows: pd.DataFrame, scores: Scores, seed: int, draws: int) -> list[dict[str, object]]:
    frames = rows.pivot(index=list(FRAME), columns="method", values="value")
    clip_means = frames.groupby(level=["scene", "clip"]).mean()
    scene_means = clip_means.groupby(level="scene").mean()
    means, units = scene_means.mean(), scene_means if len(scene_means) > 1 else clip_means
    sign = {"higher": 1, "lower": -1}.get(scores.direction, 0)
    best = str((sign * means).idxmax()) if sign else ""
    # all have the same frames, so the mean of gaps is the gap
    gaps = units.sub(units[best], axis=0) if best else units * math.nan
    intervals = intervals_of(gaps.to_numpy(np.float64), seed, draws)
    clips, unit = rows.groupby("method")["clip"].nunique(), scores.column_text("unit")
    return [
        {"method": method, "mean": means[method]}
        | difference_columns(UNKNOWN if method == best else gap, unit, scores.direction)
        | {"best": bool(best) and means[method] == means[best]}
        | {"clips": int(clips[method]), "frames": int(frames[method].count())}
        for method, gap in zip(map(str, frames.columns), intervals, strict=True)
    ]
