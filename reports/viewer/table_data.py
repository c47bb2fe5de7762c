"""What the views Table and Time compute with: ranked rows, scores of frames, provenance."""

from __future__ import annotations

import math
from collections.abc import Collection
from typing import Any

import pandas as pd

from reports.analysis.aggregate import Scores, mean_over_scenes, metrics_with_values
from reports.analysis.intervals import BOOTSTRAP_SAMPLES, UNKNOWN, Interval, interval_ends
from reports.analysis.multiplicity import correct_by_holm
from reports.analysis.notes import remarks, skip_reasons
from reports.analysis.ranking import ALL_SCENES
from reports.analysis.verdicts import name_verdict

__all__ = ["frame_scores", "provenance", "rank_at_once", "table_data"]

TIMES = ["inference_ms", "frame_ms", "mean_spp", "unreliable"]
SHOWN = ["mean", "difference", "low", "high", "best", "verdict", "mark"]
RECORDED = ("device", "dtype", "code_hash", "weights_hash", "config", "size", "preset", "run_id")


def table_data(rows: pd.DataFrame, device: str, draws: int = BOOTSTRAP_SAMPLES) -> dict[str, Any]:
    """The ranking of each metric by scene and budget, with times, and what was not measured.

    `rows` are those of one device. A record has scope (a scene, or "all"), method, spp, mean, the
    paired difference to the best with its interval, verdict, and times.
    """
    metrics = []
    for metric in metrics_with_values(rows):
        scores = Scores(rows, metric, device)
        times = pd.concat([scores.points, scores.overall.assign(scene=ALL_SCENES)])
        keys = ["method", "scene", "target_spp"]
        groups = rank_at_once(scores, draws).groupby(["scene", "target_spp"])
        ranked = pd.concat(correct_by_holm(group) for _, group in groups)
        table = ranked.merge(times[[*keys, *TIMES]], on=keys, how="left")
        metrics.append(
            {
                "metric": metric,
                "unit": scores.column_text("unit"),
                "direction": scores.direction,
                "convention": scores.convention,
                "records": table[[*keys, *SHOWN, *TIMES]].to_dict("records"),
            }
        )
    return {"metrics": metrics, "notes": [*skip_reasons(rows), *remarks(rows)]}


def rank_at_once(scores: Scores, draws: int = BOOTSTRAP_SAMPLES) -> pd.DataFrame:
    """The ranking of `rank_methods` for all methods of a scene and budget together.

    Every method of `Scores.clip_means` has the same frames, so the mean of paired differences is
    the difference of means, and all methods share one call of the bootstrap.
    """
    clips, scenes = scores.clip_means, scores.scene_means
    parts = [(str(scene), part, "clip") for scene, part in clips.groupby("scene")]
    if scenes["scene"].nunique() > 1:
        complete = mean_over_scenes(scenes)[["method", "target_spp"]]
        parts.append((ALL_SCENES, scenes.merge(complete, on=["method", "target_spp"]), "scene"))
    records = [
        {"scene": scope, "target_spp": spp, **record}
        for scope, part, unit in parts
        for spp, rows in part.groupby("target_spp")
        for record in _rank(rows.pivot(index=unit, columns="method", values="value"), scores, draws)
    ]
    return pd.DataFrame(records)


def _rank(units: pd.DataFrame, scores: Scores, draws: int) -> list[dict[str, Any]]:
    """A record of each method; `units` has a column for each method, a row for each unit."""
    means, direction = units.mean(), scores.direction
    sign = {"higher": 1, "lower": -1}.get(direction, 0)
    best = str((sign * means).idxmax())
    gaps = units.sub(units[best], axis=0) if sign else units * math.nan
    low, high = interval_ends(gaps.to_numpy(float), draws=draws)
    deviations = gaps.std(ddof=1)
    unit, records = scores.column_text("unit"), []
    for index, method in enumerate(map(str, units.columns)):
        is_best = bool(sign) and means[method] == means[best]
        gap = UNKNOWN
        if not is_best:
            ends = (float(low[index]), float(high[index]))
            gap = Interval(gaps[method].mean(), *ends, len(units), float(deviations[method]))
        records.append(
            {
                "method": method,
                "mean": means[method],
                "best": is_best,
                "difference": gap.mean,
                "low": gap.low,
                "high": gap.high,
                "verdict": name_verdict(gap, unit, direction),
                "p_value": gap.p_value,
            }
        )
    return records


def frame_scores(rows: pd.DataFrame, clips: Collection[str]) -> list[dict[str, Any]]:
    """The scores of each frame of some clips, for each metric, method and budget; seeds averaged.

    `values` begin at frame 0; a frame without a score is nan.
    """
    scored = rows[rows["clip"].isin(clips) & (rows["frame"] >= 0) & (rows["direction"] != "")]
    scored = scored[(scored["unit"] != "ms") & scored["value"].notna()]
    if scored.empty:
        return []
    table = scored.pivot_table("value", ["metric", "clip", "method", "target_spp"], "frame")
    table = table.reindex(columns=range(int(scored["frame"].max()) + 1))
    return [
        {"metric": metric, "clip": clip, "method": method, "spp": spp, "values": values}
        for (metric, clip, method, spp), values in zip(
            table.index, table.round(4).to_numpy().tolist(), strict=True
        )
    ]


def provenance(rows: pd.DataFrame) -> dict[str, dict[str, str]]:
    """By method: device, precision, hashes of code and weights, config, and notes on its rows."""
    found: dict[str, dict[str, str]] = {}
    for method, own in rows[rows["metric"] != "sample_ms"].groupby("method"):
        texts = {name: ", ".join(sorted(set(own[name]) - {"", "{}"})) for name in RECORDED}
        seeds = ", ".join(str(seed) for seed in sorted(set(own["seed"])))
        found[str(method)] = {name: text for name, text in texts.items() if text} | {"seeds": seeds}
    return found
