"""For what a score generalises: its variance by scene, by training and by order of samples."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from reports.analysis.aggregate import Scores
from reports.analysis.comparability import check_comparable, split_by_device
from reports.analysis.method_names import training_series_of
from reports.analysis.variance_parts import variance_parts
from reports.layout.page import Section, write_page
from reports.layout.tables import Table
from rlbench.benchmark.results import MissingRowsError

__all__ = ["estimate_parts", "write"]

BASE = "ours"  # the method whose scores are subtracted, training by training where it has several
METRIC = "psnr"
FACTORS = ("scene", "training", "order")
PARTS = ("scene", "training", "order", "rest", "same_scenes", "other_scenes")
HEADER = (
    "row", "spp", "scenes", "trainings", "orders", "mean", "between scenes", "between trainings",
    "between orders", "rest", "error: these scenes", "error: other scenes",
)  # fmt: skip


def write(results: pd.DataFrame, folder: Path, name: str = "variance") -> list[Path]:
    """Write `name`.md, .csv and .tex: parts of variance of each row, and of its lead over `ours`.

    Rows of several trainings are those of the report `seeds` (ours@seed0, ...); orders of samples
    come from `rlbench run --draws K`. Raises MissingRowsError if no row has several of either.
    """
    sections = []
    for device, rows in split_by_device(results).items():
        check_comparable(rows)
        scores = Scores(rows, METRIC, device)
        records = estimate_parts(scores)
        if len(records):
            parts = [records[records["minus"] == minus] for minus in ("", BASE)]
            tables = [_table(scores, part) for part in parts if len(part)]
            lists = {"Not run": scores.skip_reasons, "Remarks": scores.remarks}
            sections.append(Section(device, tables, records, lists))
    if not sections:
        raise MissingRowsError(
            "no row was measured with two orders of samples or two trainings; measure some with "
            "rlbench run --draws 4, or rlbench run --weights seed0=FILE and seed1=FILE"
        )
    return write_page(folder, name, "Parts of variance", results, sections)


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
            *("-" if row[name] != row[name] else f"{row[name]:.3f}" for name in PARTS),
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
