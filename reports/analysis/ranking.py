"""Who is best at each budget, by how much the others fall short, and who is as good."""

from __future__ import annotations

import math

import pandas as pd

from reports.analysis import aggregate
from reports.analysis.intervals import DRAWS, interval, paired

EVERY = "all"  # the scene column of means over every scene
COLUMNS = (
    "metric", "scene", "target_spp", "method", "mean", "difference", "low", "high", "best", "tie",
    "clips", "frames",
)  # fmt: skip


def ranking(table: pd.DataFrame, metric: str, seed: int = 0, draws: int = DRAWS) -> pd.DataFrame:
    """A row for each method, budget and scene, and scene "all" for the mean over scenes.

    `difference` is the mean of the paired differences to the best method at that budget, `low` and
    `high` its interval (nan with one scene and clip), `tie` whether that holds zero. Nothing is
    best where the metric has no better end. For "all", methods that lack a scene are left out.
    """
    better = aggregate.column_text(table, metric, "direction")
    every = aggregate.per_frame_scores(table, metric)
    whole = aggregate.overall(aggregate.scene_means(table, metric))[["method", "target_spp"]]
    parts = [(EVERY, every.merge(whole, on=["method", "target_spp"]))]
    parts += [(str(scene), rows) for scene, rows in every.groupby("scene")]
    made = []
    for scene, rows in parts:
        for spp, methods in rows.groupby("target_spp"):
            ranked = _rank(methods, better, seed, draws)
            made += [{"metric": metric, "scene": scene, "target_spp": spp, **row} for row in ranked]
    return pd.DataFrame(made, columns=list(COLUMNS))


def _rank(rows: pd.DataFrame, better: str, seed: int, draws: int) -> list[dict[str, object]]:
    shots = {str(method): part for method, part in rows.groupby("method")}
    means = {method: _mean(part) for method, part in shots.items()}
    sign = {"higher": 1, "lower": -1}.get(better, 0)
    best = max(means, key=lambda method: sign * means[method]) if sign else ""
    ranked = []
    for method, part in shots.items():
        found = dict.fromkeys(("difference", "low", "high"), math.nan)
        tie = False
        if best and method != best:
            gap = interval(paired(part, shots[best]), seed, draws)
            found, tie = {"difference": gap.mean, "low": gap.low, "high": gap.high}, gap.tie
        counts = {"clips": part["clip"].nunique(), "frames": len(part)}
        ranked.append(
            {"method": method, "mean": means[method], **found, "tie": tie}
            | {"best": bool(best) and means[method] == means[best]}
            | counts
        )
    return ranked


def _mean(shots: pd.DataFrame) -> float:
    """Mean over frames of a clip, then over clips of a scene, then over scenes."""
    clips = shots.groupby(["scene", "clip"])["value"].mean()
    return float(clips.groupby("scene").mean().mean())
