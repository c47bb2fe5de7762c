"""Results of methods whose score is a + b log2(spp), so that every answer has a closed form."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from reports.analysis.curves import Curve
from rlbench.benchmark.results import UNCERTAIN, Row, to_dataframe

BUDGETS = (1.0, 2.0, 4.0)


@dataclass(frozen=True)
class Formula:
    at_1_spp: float  # dB
    per_doubling: float  # dB
    fixed_ms: float
    by_scene: float = 0.0  # dB that are added in one scene and missing in the other
    sample_ms: float = 2.0
    budgets: tuple[float, ...] = BUDGETS
    gbuffer_ms: float = 0.0

    def score(self, spp):
        return self.at_1_spp + self.per_doubling * np.log2(spp)


THREE = {  # at 2 ms a sample
    "cheap": Formula(20.0, 3.0, 1.0),
    "middle": Formula(26.0, 1.0, 5.0),
    "slow": Formula(27.5, 1.0, 12.0),
}


def table(methods, scenes=("city", "hall"), size="192x192", device="CPU, 2 threads"):
    rows = []
    for name, formula in methods.items():
        for sign, scene in zip((1, -1, 0, 0), scenes, strict=False):
            for spp in formula.budgets:
                value = formula.score(spp) + sign * (5 + formula.by_scene)
                rows += _cell(name, scene, spp, value, formula, size, device)
    return to_dataframe(rows)


def _cell(name, scene, spp, value, formula, size, device):
    def row(frame, metric, number, unit, direction, convention):
        return Row(
            "r1", name, scene, scene, spp, spp, frame, metric, float(number), unit, direction,
            convention, device=device, size=size,
        )  # fmt: skip

    plan, denoise = 0.25 * formula.fixed_ms, 0.75 * formula.fixed_ms
    times = {"plan_ms": plan, "denoise_ms": denoise, "inference_p95_ms": 2 * formula.fixed_ms}
    times |= {
        "gbuffer_ms": formula.gbuffer_ms,
        "allocate_ms": 0.0,
        "sampling_ms": spp * formula.sample_ms,
    }
    return [
        *(row(frame, "psnr", value, "dB", "higher", "peak 1") for frame in range(2)),
        *(row(-1, metric, ms, "ms", "lower", "median") for metric, ms in times.items()),
        row(-1, "sample_ms", formula.sample_ms, "ms", "lower", "path tracer, measured here"),
    ]


def curve(name, spp, values, fixed_ms, sign=1):
    """A curve of one scene and equal samples."""
    spp = np.asarray(spp, float)
    fixed = np.broadcast_to(np.asarray(fixed_ms, float), spp.shape)
    units = np.asarray(values, float)[:, None]
    return Curve(name, spp, units, fixed, spp, 2 * fixed, fixed, fixed, sign)


def doubt(rows, *methods, low=0.5, high=2.0, scene=None):
    """The rows with an interval of the inference times of `methods`, relative to these."""
    is_own = rows["method"].isin(methods) & (rows["scene"].eq(scene) if scene else True)
    is_inference = rows["metric"].isin(["inference_ms", "inference_low_ms", "inference_high_ms"])
    parts = rows[is_own & rows["metric"].isin(["plan_ms", "allocate_ms", "denoise_ms"])]
    keys = [name for name in parts.columns if name not in ("metric", "value", "convention", "note")]
    inference = parts.groupby(keys, as_index=False)["value"].sum()
    inference = inference.assign(convention="sum", note="")
    ends = [
        inference.assign(metric=f"inference_{end}_ms", value=share * inference["value"])
        for end, share in (("low", low), ("high", high))
    ]
    noted = inference.assign(metric="inference_ms", note=f"{UNCERTAIN} the machine was busy")
    return pd.concat([rows[~(is_own & is_inference)], noted, *ends], ignore_index=True)
