"""What the views Table and Time compute with: ranked rows, scores of frames, provenance."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

import pandas as pd

from reports.analysis.aggregate import Scores, metrics_with_values
from reports.analysis.intervals import BOOTSTRAP_SAMPLES
from reports.analysis.multiplicity import correct_by_holm
from reports.analysis.notes import remarks, skip_reasons
from reports.analysis.ranking import ALL_SCENES, rank_methods

__all__ = ["frame_scores", "provenance", "table_data"]

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
        groups = rank_methods(scores, draws=draws).groupby(["scene", "target_spp"])
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
