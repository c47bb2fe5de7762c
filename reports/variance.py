"""For what a score generalises: its variance by scene, by training and by order of samples.

Every score is a mean plus random effects of the factors it was measured at, and of their
combinations: a crossed design with random effects and one score in each cell. Its mean squares are
solved for the variances by the method of moments (Searle, Casella and McCulloch 1992, Variance
Components, chapter 4). The estimates are unbiased, so one near zero may be negative. Sums keep the
sign; a sum below zero is reported as zero.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain, combinations
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from reports.analysis.rows import training_series_of
from reports.analysis.scores import Scores
from reports.layout.page import Section, write_report
from reports.layout.tables import Table, format_number

BASE = "ours"  # the method whose scores are subtracted, training by training where it has several
FACTORS = ("scene", "training", "order")
PARTS = ("scene", "training", "order", "rest", "same_scenes", "other_scenes")
HEADER = (
    "row", "spp", "scenes", "trainings", "orders", "mean", "between scenes", "between trainings",
    "between orders", "rest", "error: these scenes", "error: other scenes",
)  # fmt: skip
Effect = tuple[str, ...]  # the factors of a random effect, in their order


def write(results: pd.DataFrame, folder: Path, name: str = "variance") -> list[Path]:
    """Write parts of variance of each row, and of its lead over `ours`, see `write_report`.

    Rows of several trainings are those of the report `seeds` (ours@seed0, ...); orders of samples
    come from `rlbench run --draws K`.
    """
    missing = (
        "no row was measured with two orders of samples or two trainings; measure some with "
        "rlbench run --draws 4, or rlbench run --weights seed0=FILE and seed1=FILE"
    )
    return write_report(results, folder, name, "Parts of variance", _section, missing)


def _section(scores: Scores) -> Section | None:
    records = estimate_parts(scores)
    if records.empty:
        return None
    parts = [records[records["minus"] == minus] for minus in ("", BASE)]
    tables = [_table(scores, part) for part in parts if len(part)]
    lists = {"Not run": scores.skip_reasons, "Remarks": scores.remarks}
    return Section(scores.device, tables, records, lists)


def estimate_parts(scores: Scores) -> pd.DataFrame:
    """A record for each row or series of trainings and budget, alone and minus `ours`.

    Columns row, minus ("" or `ours`), target_spp, the number of levels of each factor, mean, the
    deviations scene, training, order and rest in dB, and the standard errors same_scenes and
    other_scenes. A row is left out if one of its combinations has no score.
    """
    means = _cell_means(scores)
    records = []
    for (row, spp), part in means.groupby(["row", "target_spp"]):
        base = means[(means["row"] == _base_row(str(row))) & (means["target_spp"] == spp)]
        tables = (
            {"": part} if row == _base_row(str(row)) else {"": part, BASE: _subtract(part, base)}
        )
        for minus, table in tables.items():
            if estimate := _estimate(table):
                records.append({"row": row, "minus": minus, "target_spp": spp, **estimate})
    return pd.DataFrame(records)


def _cell_means(scores: Scores) -> pd.DataFrame:
    """Mean over frames, then clips, of each row, training, budget, scene and order."""
    keys = ["method", "target_spp", "scene", "seed"]
    clips = scores.measured.groupby([*keys, "clip"])["value"].mean()
    means = pd.DataFrame(clips.groupby(keys).mean().reset_index())
    series = means["method"].map(training_series_of)
    is_series = means.groupby(series)["method"].transform("nunique") > 1
    series = series.where(is_series, "")
    return means.assign(
        row=series.where(series != "", means["method"]),
        training=means["method"].where(series != "", "").str.extract(r"(\d*)$")[0],
        order=means["seed"],
    )


def _base_row(row: str) -> str:
    """The row of `ours` with the same label."""
    _, at, label = row.partition("@")
    return f"{BASE}{at}{label}"


def _subtract(part: pd.DataFrame, base: pd.DataFrame) -> pd.DataFrame:
    """Scores minus those of the base at the same scene and order, in the training of its number."""
    keys = ["scene", "order", "training"]
    both = part.merge(base[[*keys, "value"]], on=keys, suffixes=("", "_base"))
    return both.assign(value=both["value"] - both["value_base"])


def _estimate(table: pd.DataFrame) -> dict[str, Any] | None:
    """The parts of a row at a budget; None if a cell is absent, or nothing but scenes varies."""
    counts = [table[factor].nunique() for factor in FACTORS]
    scenes, *others = counts
    if len(table) != np.prod(counts) or scenes < 2 or max(others) < 2:
        return None
    array = table.sort_values(list(FACTORS))["value"].to_numpy(float).reshape(counts)
    parts = variance_parts(array, FACTORS)
    repeated = [factor for factor in FACTORS[1:] if factor in parts.levels]
    mixed = [effect for effect in parts.variances if "training" in effect and len(effect) > 1]
    return {
        **dict(zip(("scenes", "trainings", "orders"), counts, strict=True)),
        "mean": parts.mean,
        "scene": parts.deviation(("scene",)),
        "training": parts.deviation(("training",)),
        # one seed orders the samples of two scenes differently, so orders belong to their scene
        "order": parts.deviation(("order",), ("scene", "order")),
        "rest": parts.deviation(*mixed),
        "same_scenes": parts.standard_error(*repeated),
        "other_scenes": parts.standard_error("scene", *repeated),
    }


def _table(scores: Scores, records: pd.DataFrame) -> Table:
    minus = records["minus"].iloc[0]
    rows = tuple(
        (
            f"{row['row']}0, ..." if row["trainings"] > 1 else str(row["row"]),
            f"{row['target_spp']:g}",
            *(str(row[name]) for name in ("scenes", "trainings", "orders")),
            f"{row['mean']:+.2f}" if minus else f"{row['mean']:.2f}",
            *(format_number(row[name], ".3f") for name in PARTS),
        )
        for row in records.to_dict("records")
    )
    of = f"the difference to {minus} at the same scene, order and training number" if minus else ""
    caption = (
        f"PSNR in dB ({scores.convention}){': ' * bool(of)}{of}. Standard deviations between "
        "scenes, trainings and orders of samples (within a scene), by analysis of variance; rest: "
        "what a training does on one scene or order alone. Standard errors of the mean: on these "
        "scenes with new trainings and orders, and on other scenes too. A dash: one level, so "
        "nothing is known beyond it."
    )
    title = f"Parts of variance of the difference to {minus}" if minus else "Parts of variance"
    return Table(title, caption, HEADER, rows)


@dataclass(frozen=True)
class VarianceParts:
    """Variances of random effects, in the square of the scores' unit, by the factors they need."""

    mean: float
    levels: dict[str, int]  # of each factor with at least two levels
    variances: dict[Effect, float]  # unbiased estimates, which may be negative

    def deviation(self, *effects: Effect) -> float:
        """Standard deviation of the sum of these effects; nan if none was measured."""
        known = [self.variances[effect] for effect in effects if effect in self.variances]
        return math.sqrt(max(0.0, sum(known))) if known else math.nan

    def standard_error(self, *fresh: str) -> float:
        """Standard error of the mean, if the factors in `fresh` were drawn anew.

        All others stay as they are, so effects without a fresh factor do not count: a claim about
        other scenes needs `fresh="scene"`. Nan if one of `fresh` was measured at one level only.
        """
        if not set(fresh) <= self.levels.keys():
            return math.nan
        shares = [
            variance / math.prod(self.levels[factor] for factor in effect)
            for effect, variance in self.variances.items()
            if set(effect) & set(fresh)
        ]
        return math.sqrt(max(0.0, sum(shares)))


def variance_parts(scores: NDArray[np.float64], factors: Sequence[str]) -> VarianceParts:
    """Estimate the parts of `scores`, an array with one axis for each of `factors`.

    Factors with one level are left out. Raises ValueError for an array with other axes, or a nan.

    >>> parts = variance_parts(np.array([[1.0, 1.2], [3.0, 3.2]]), ("scene", "order"))
    >>> round(parts.deviation(("scene",)), 3), round(parts.deviation(("order",)), 3)
    (1.414, 0.141)
    """
    if scores.ndim != len(factors) or np.isnan(scores).any():
        raise ValueError(
            f"scores have {scores.ndim} axes for {len(factors)} factors, and "
            f"{np.isnan(scores).sum()} of them are nan; give one score for each combination"
        )
    levels = {f: n for f, n in zip(factors, scores.shape, strict=True) if n > 1}
    table = scores.reshape(tuple(levels.values()))
    sizes = range(1, len(levels) + 1)
    effects = list(chain.from_iterable(combinations(levels, size) for size in sizes))
    squares = {effect: _mean_square(table, tuple(levels), effect) for effect in effects}
    variances = {}
    for effect in effects:
        # E[MS of u] = sum over v that contain u of var(v) x the levels outside v: inclusion and
        # exclusion over the sets above u gives var(u)
        above = [other for other in effects if set(effect) <= set(other)]
        signed = sum((-1) ** (len(other) - len(effect)) * squares[other] for other in above)
        outside = math.prod(n for factor, n in levels.items() if factor not in effect)
        variances[effect] = float(signed / outside)
    return VarianceParts(float(scores.mean()), levels, variances)


def _mean_square(table: NDArray[np.float64], factors: Effect, effect: Effect) -> float:
    """Mean square of an effect: the squared interaction contrast by its degrees of freedom."""
    contrast = table
    for axis, factor in enumerate(factors):
        mean = contrast.mean(axis=axis, keepdims=True)
        contrast = contrast - mean if factor in effect else np.broadcast_to(mean, contrast.shape)
    freedom = math.prod(table.shape[factors.index(factor)] - 1 for factor in effect)
    return float((contrast**2).sum() / freedom)
