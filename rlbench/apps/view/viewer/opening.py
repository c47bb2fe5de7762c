"""The question with which the page opens, and the budget of its answer."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import pandas as pd

from reports.analysis.curves import curves_of, denoisers, find_winners, measured_sample_ms
from reports.analysis.rows import split_by_device
from reports.analysis.scores import Scores, metrics_with_values

DEADLINES = (16.7, 33.3, 100.0, 250.0, 500.0, 1000.0)  # ms, that users have


class Opening(NamedTuple):
    """A cost of a sample and a deadline, and the best budget within it."""

    sample_ms: float
    deadline_ms: float
    spp: float


def choose_opening(results: pd.DataFrame) -> Opening | None:
    """The measured cost, and the first usual deadline that half of the denoisers meet.

    These are the first device and metric of the page. None where nothing was timed.
    """
    device, rows = next(iter(split_by_device(results).items()), ("", results))
    metric = next((m for m in metrics_with_values(rows) if Scores(rows, m, device).direction), None)
    if metric is None:
        return None
    scores = Scores(rows, metric, device)
    curves, measured = denoisers(curves_of(scores)), measured_sample_ms(scores)
    if not curves or not measured > 0:
        return None
    sample_ms = float(f"{measured:.3g}")
    least = sorted(float(curve.frame_ms(sample_ms).min()) for curve in curves)
    needed = least[len(least) // 2]
    deadline = next((time for time in DEADLINES if time >= needed), DEADLINES[-1])
    winners = find_winners(curves, np.array([sample_ms]), np.array([deadline]))
    spp = float(winners.spp[winners.first[0], 0])
    return None if math.isnan(spp) else Opening(sample_ms, deadline, spp)
