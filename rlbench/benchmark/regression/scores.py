"""Scores of a results table as the regression check compares them: one PSNR a cell and seed."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

from rlbench.benchmark.regression.baseline import BaselineError, ScoreKey

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["DECIMALS", "Score", "only_preset", "scores", "seeds"]

DECIMALS = 4  # of dB, in the file and in the comparison


class Score(NamedTuple):
    """PSNR of a method on a scene at a budget, over the frames of all clips."""

    psnr: float  # mean, dB
    stderr_db: float | None  # standard error of the mean over frames; None for one frame
    frames: int


def scores(table: pd.DataFrame, seed: int) -> dict[ScoreKey, Score | None]:
    """The score of each method, scene and budget, or None if a frame has no finite value.

    Frames differ in content and are alike in time, so the standard error describes the clip: how
    well these frames stand for others. It is not what a rerun varies by. Raises BaselineError if
    the results are of several devices, or without `seed`.
    """
    rows = table[table["metric"] == "psnr"]
    if len(devices := sorted(set(rows["device"]) - {""})) > 1:
        raise BaselineError(
            f"the results are of {len(devices)} devices ({', '.join(devices)}). Measure on one "
            "device, into a folder of its own"
        )
    if len(rows) and seed not in (found := seeds(table)):
        raise BaselineError(
            f"the results are of seed {', '.join(map(str, found))}, the baseline is of seed "
            f"{seed}. Measure it too: rlbench run --seed {seed}"
        )
    groups = rows[rows["seed"] == seed].groupby(["method", "scene", "target_spp"])["value"]
    means = groups.agg(lambda values: values.mean(skipna=False))
    return {
        ScoreKey(*key): _score(mean, error, int(frames)) if math.isfinite(mean) else None
        for key, mean, error, frames in zip(
            means.index, means, groups.sem(), groups.size(), strict=True
        )
    }


def _score(mean: float, error: float, frames: int) -> Score:
    return Score(round(mean, DECIMALS), None if frames < 2 else round(error, DECIMALS), frames)


def seeds(table: pd.DataFrame) -> list[int]:
    """The seeds of the sample order that the scores have, sorted."""
    return sorted({int(seed) for seed in table.loc[table["metric"] == "psnr", "seed"]})


def only_preset(table: pd.DataFrame) -> str:
    """The preset of all clips. Raises BaselineError if there are several."""
    presets = sorted(set(table["preset"]))
    if len(presets) > 1:
        names = ", ".join(preset or "none" for preset in presets)
        raise BaselineError(
            f"the results are of {len(presets)} presets ({names}). Measure one preset only"
        )
    return presets[0] if presets else ""
