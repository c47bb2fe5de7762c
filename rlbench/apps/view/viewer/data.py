"""What the views of the page show: curves, ranked rows, scores of frames, provenance."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from typing import Any

import pandas as pd
from scipy import stats

from reports.analysis.curves import (
    Curve,
    curves_of,
    denoisers,
    measured_sample_ms,
    methods_without_curve,
)
from reports.analysis.differences import ALL_SCENES, correct_by_holm, rank_methods
from reports.analysis.intervals import LEVEL
from reports.analysis.rows import remarks, skip_reasons
from reports.analysis.scores import Scores, metrics_with_values
from reports.layout.tables import score_name, uncertainty_of

KEYS = ["method", "scene", "target_spp"]
TIMES = ["inference_ms", "frame_ms", "mean_spp"]
DOUBTS = ["inference_uncertainty", "frame_uncertainty"]
SHOWN = ["mean", "difference", "low", "high", "best", "verdict", "mark"]
RECORDED = ("device", "dtype", "code_hash", "weights_hash", "config", "size", "preset", "run_id")


def decision_data(rows: pd.DataFrame, device: str) -> list[dict[str, Any]]:
    """For each metric that ranks methods: its curves over all scenes, and over each scene.

    `rows` are those of one device. A curve has `spp` and `fixed_ms` [budgets], `units` [budgets
    units], `samples`, `low_ms` and `high_ms` [budgets], `gbuffer_ms` and `gbuffer_samples`, as in
    `reports.analysis.curves`; those that do not `compete` are not ranked.
    """
    described = []
    for metric in metrics_with_values(rows):
        scores = Scores(rows, metric, device)
        if not scores.direction:
            continue
        scenes = sorted(set(scores.measured["scene"]))
        parts = [("mean over scenes", scores)] if len(scenes) > 1 else []
        parts += [(s, replace(scores, rows=rows[rows["scene"] == s])) for s in scenes]
        scopes = [scope for name, part in parts if (scope := _scope(name, part))["curves"]]
        if scopes:
            described.append(
                {
                    "metric": metric,
                    "title": score_name(metric),
                    "unit": scores.column_text("unit"),
                    "convention": scores.convention,
                    "sign": -1 if scores.direction == "lower" else 1,
                    "cost_source": scores.cost_source,
                    "device_mixes": list(scores.device_mixes),
                    "scopes": scopes,
                }
            )
    return described


def student_factors(units: int) -> list[float]:
    """Half width of the 95 % interval in standard errors, by number of units up to `units`.

    Without two units there is no interval: the first two are 0.

    >>> [round(factor, 2) for factor in student_factors(4)]
    [0.0, 0.0, 12.71, 4.3, 3.18]
    """
    known = [float(stats.t.ppf((1 + LEVEL) / 2, count - 1)) for count in range(2, units + 1)]
    return [0.0, 0.0, *known]


def _scope(name: str, scores: Scores) -> dict[str, Any]:
    curves = curves_of(scores)
    competing = denoisers(curves)
    return {
        "name": name,
        "unit": "scenes" if scores.scene_means["scene"].nunique() > 1 else "clips",
        "sample_ms": measured_sample_ms(scores),
        "uncertain_times": scores.uncertain_times,
        "curves": [_curve(curve, curve in competing) for curve in curves],
        "missing": methods_without_curve(scores, curves),
    }


def _curve(curve: Curve, is_competing: bool) -> dict[str, Any]:
    return {
        "method": curve.method,
        "spp": curve.spp.tolist(),
        "units": curve.units.tolist(),
        "fixed_ms": curve.fixed_ms.tolist(),
        "low_ms": curve.low_ms.tolist(),
        "high_ms": curve.high_ms.tolist(),
        "samples": curve.samples.tolist(),
        "gbuffer_ms": curve.gbuffer_ms,
        "gbuffer_samples": curve.gbuffer_samples,
        "competes": is_competing,
    }


def table_data(rows: pd.DataFrame, device: str) -> dict[str, Any]:
    """The ranking of each metric by scene and budget, with times, and what was not measured.

    `rows` are those of one device. A record has scope (a scene, or "all"), method, spp, mean, the
    paired difference to the best with its interval, verdict, and times.
    """
    metrics = []
    every = [Scores(rows, metric, device) for metric in metrics_with_values(rows)]
    ranks = correct_by_holm(pd.concat(map(rank_methods, every))) if every else pd.DataFrame()
    for scores in every:
        times = pd.concat([scores.points, scores.overall.assign(scene=ALL_SCENES)])
        for part in ("inference", "frame"):
            times[f"{part}_uncertainty"] = [
                uncertainty_of(row, part) for row in times.to_dict("records")
            ]
        ranked = ranks[ranks["metric"] == scores.metric]
        table = ranked.merge(times[[*KEYS, *TIMES, *DOUBTS]], on=KEYS, how="left")
        metrics.append(
            {
                "metric": scores.metric,
                "title": score_name(scores.metric),
                "unit": scores.column_text("unit"),
                "direction": scores.direction,
                "convention": scores.convention,
                "records": table[[*KEYS, *SHOWN, *TIMES, *DOUBTS]].to_dict("records"),
            }
        )
    return {"metrics": metrics, "notes": [*skip_reasons(rows), *remarks(rows)]}


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
