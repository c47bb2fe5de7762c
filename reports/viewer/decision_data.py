"""What the view Decide computes with: the curves of all methods, per device, metric and scene."""

from __future__ import annotations

from typing import Any

import pandas as pd
from scipy import stats

from reports.analysis.aggregate import Scores, metrics_with_values
from reports.analysis.curves import Curve, curves_of, measured_sample_ms, methods_without_curve
from reports.analysis.intervals import LEVEL

__all__ = ["ALL_SCENES", "decision_data", "student_factors"]

ALL_SCENES = "mean over scenes"


def decision_data(rows: pd.DataFrame, device: str) -> list[dict[str, Any]]:
    """For each metric that ranks methods: its curves over all scenes, and over each scene.

    `rows` are those of one device. A curve has `spp` and `fixed_ms` [budgets], `units` [budgets
    units], `samples` [budgets] and `unreliable` [budgets], as in `reports.analysis.curves`.
    """
    described = []
    for metric in metrics_with_values(rows):
        scores = Scores(rows, metric, device)
        if not scores.direction:
            continue
        scenes = sorted(set(scores.measured["scene"]))
        parts = [(ALL_SCENES, scores)] if len(scenes) > 1 else []
        parts += [(s, Scores(rows[rows["scene"] == s], metric, device)) for s in scenes]
        scopes = [_scope(name, part) for name, part in parts]
        if not any(scope["curves"] for scope in scopes):
            continue
        described.append(
            {
                "metric": metric,
                "unit": scores.column_text("unit"),
                "convention": scores.convention,
                "sign": -1 if scores.direction == "lower" else 1,
                "cost_source": scores.cost_source,
                "scopes": [scope for scope in scopes if scope["curves"]],
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
    points = scores.points
    marked = points[points["unreliable"]]
    unreliable = {(str(m), float(s)) for m, s in marked[["method", "target_spp"]].to_numpy()}
    return {
        "name": name,
        "unit": "scenes" if scores.scene_means["scene"].nunique() > 1 else "clips",
        "sample_ms": measured_sample_ms(scores),
        "curves": [_curve(curve, unreliable) for curve in curves],
        "missing": methods_without_curve(scores, curves),
    }


def _curve(curve: Curve, unreliable: set[tuple[str, float]]) -> dict[str, Any]:
    return {
        "method": curve.method,
        "spp": curve.spp.tolist(),
        "units": curve.units.tolist(),
        "fixed_ms": curve.fixed_ms.tolist(),
        "samples": curve.samples.tolist(),
        "unreliable": [(curve.method, float(spp)) in unreliable for spp in curve.spp],
    }
