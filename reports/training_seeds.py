"""Trainings with different seeds: the deviation of their scores, and differences between rows."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from scipy import stats

from reports.analysis.differences import HOLM_MARK, correct_by_holm, name_verdict
from reports.analysis.intervals import LEVEL, Interval
from reports.analysis.rows import (
    ReportError,
    check_comparable,
    label_of,
    split_by_device,
    training_series_of,
    without_label,
)
from reports.analysis.scores import Scores, mean_over_scenes
from reports.layout.page import Section, write_page
from reports.layout.tables import Table, format_difference, pivot, rank_rows
from reports.published import published
from rlbench.benchmark.results import MissingRowsError

BASE = "ours"  # the method that others are compared with, if it was trained several times
DIFFERENCES = [
    "series", "target_spp", "difference", "difference_low", "difference_high", "p_value", "verdict",
]  # fmt: skip


def write(results: pd.DataFrame, folder: Path, name: str = "seeds") -> list[Path]:
    """Write `name`.md, .csv and .tex: a row for each series of trainings and budget.

    A series are methods whose names differ only in the number at the end of their label:
    ours@seed0, ours@seed1, ... Raises MissingRowsError if no series has two trainings, and
    ReportError if two trainings have the same weights.
    """
    sections = []
    for device, rows in split_by_device(results).items():
        trained = rows[rows["method"].map(training_series_of) != ""]
        scores = Scores(trained, device=device)
        records = deviations(scores)
        if len(records):
            check_comparable(trained)
            tables = [_deviation_table(scores, records)]
            differences = differences_to(mean_over_scenes(scores.scene_means))
            tables += [_difference_table(scores, differences)] if len(differences) else []
            both = records.merge(differences, on=["series", "target_spp"], how="left")
            sections.append(Section(device, tables, both, _lists(scores, records)))
    if not sections:
        labelled = sorted({method for method in results["method"] if label_of(method)})
        raise MissingRowsError(
            "no method has scores of two trainings, as in ours@seed0 and ours@seed1; methods with "
            f"a label in the results: {', '.join(labelled) or 'none'}. Score trained weights with "
            "rlbench run --weights seed0=FILE"
        )
    return write_page(folder, name, "Training seeds", results, sections)


def deviations(scores: Scores) -> pd.DataFrame:
    """Standard deviation between trainings, per series and budget, of their means over scenes.

    `deviation` has n - 1 in the denominator, `low` and `high` are its 95 % chi-square interval. A
    training that lacks a scene at a budget is left out there; a budget needs two trainings.
    """
    _check_distinct_weights(scores)
    means = mean_over_scenes(scores.scene_means)
    records = []
    for series, trainings in means.groupby(means["method"].map(training_series_of)):
        for spp, part in trainings.groupby("target_spp"):
            if len(part) > 1:
                records.append({"series": series, "target_spp": spp, **_describe(part["value"])})
    return pd.DataFrame(records)


def _describe(values: pd.Series[float]) -> dict[str, float]:
    deviation = std_with_interval(list(values))
    return {
        "mean": values.mean(),
        **deviation._asdict(),
        "least": values.min(),
        "most": values.max(),
        "trainings": len(values),
    }


class Deviation(NamedTuple):
    """Standard deviation of a sample, n - 1 in the denominator, and its confidence interval."""

    deviation: float  # nan with one number
    low: float
    high: float


def std_with_interval(values: Sequence[float]) -> Deviation:
    """Standard deviation and its chi-square interval, which assumes normally distributed values."""
    if len(values) < 2:
        return Deviation(math.nan, math.nan, math.nan)
    deviation, freedom = float(np.std(values, ddof=1)), len(values) - 1
    low, high = (
        deviation * math.sqrt(freedom / float(stats.chi2.isf(tail, freedom)))
        for tail in ((1 - LEVEL) / 2, (1 + LEVEL) / 2)
    )
    return Deviation(deviation, low, high)


def _check_distinct_weights(scores: Scores) -> None:
    """Raise ReportError if two trainings of a series have the same weights."""
    known = scores.measured[scores.measured["weights_hash"] != ""]
    known = known.drop_duplicates(["method", "weights_hash"])
    for (_, weights), part in known.groupby(
        [known["method"].map(training_series_of), "weights_hash"]
    ):
        if len(part) > 1:
            raise ReportError(
                f"{' and '.join(sorted(part['method']))} ran with the same weights ({weights}); "
                "a deviation between trainings needs weights of different seeds"
            )


def differences_to(means: pd.DataFrame, base: str = BASE) -> pd.DataFrame:
    """Mean of each series of trainings minus the mean of the trainings of `base`, per budget.

    `means` has the columns method, target_spp and value, one row per training. `difference_low` and
    `difference_high` are the interval of Welch's t-test (Welch 1947), which assumes normal,
    independent trainings and allows unequal variances. Series are compared if their labels differ
    only in the number; at least two trainings of each are needed at a budget. `p_value` is that of
    the test, `p_holm` and `mark` its correction over all differences.
    """
    records = []
    for (label, spp), part in means.groupby([means["method"].map(_label_word), "target_spp"]):
        trainings = dict(list(part.groupby(part["method"].map(without_label))["value"]))
        ours = trainings.pop(base, pd.Series(dtype=float))
        for row, theirs in trainings.items():
            if min(len(ours), len(theirs)) > 1:
                low, high, p = _welch_test(theirs.to_numpy(), ours.to_numpy())
                gap = Interval(theirs.mean() - ours.mean(), low, high, len(theirs) + len(ours))
                verdict = name_verdict(gap, "dB")
                records.append((f"{row}@{label}", spp, gap.mean, low, high, p, verdict))
    return correct_by_holm(pd.DataFrame(records, columns=DIFFERENCES))


def _welch_test(first: np.ndarray, second: np.ndarray) -> tuple[float, float, float]:
    """The ends of the interval of the difference of two means, and the p-value that it is zero."""
    # scipy gives nan where neither side varies; then the difference is exact
    if math.isclose(first.std() + second.std(), 0.0, abs_tol=1e-12):
        difference = first.mean() - second.mean()
        return difference, difference, float(difference == 0)
    test = stats.ttest_ind(first, second, equal_var=False)
    ends = test.confidence_interval(LEVEL)
    return float(ends.low), float(ends.high), float(test.pvalue)


def _label_word(method: str) -> str:
    """The label without the number at its end."""
    return training_series_of(method).partition("@")[2]


def _deviation_table(scores: Scores, records: pd.DataFrame) -> Table:
    paper = published()
    rows = tuple(
        (
            f"{row['series']}0, ...",
            f"{row['target_spp']:g}",
            f"{row['trainings']}",
            f"{row['mean']:.2f}",
            f"{row['deviation']:.3f} [{row['low']:.3f}, {row['high']:.3f}]",
            f"{row['least']:.2f} to {row['most']:.2f}",
            f"{paper.deviation_db:g}"
            if without_label(row["series"]) == paper.deviation_row
            else "-",
        )
        for row in records.to_dict("records")
    )
    header = ("series", "spp", "trainings", "mean", "deviation", "range", "paper")
    caption = (
        f"PSNR in dB ({scores.convention}), mean over scenes, of trainings that differ only in "
        "their seed. Deviation: standard deviation (n - 1). Brackets: its 95 % chi-square "
        "interval, which assumes normally distributed trainings. Paper: "
        f"{paper.deviation_db:g} dB from {paper.trainings} trainings, budget not stated "
        f"({paper.title}). Measured on {scores.device_name}."
    )
    return Table("Standard deviation between training seeds [dB]", caption, header, rows)


def _difference_table(scores: Scores, differences: pd.DataFrame) -> Table:
    named = differences.assign(method=differences["series"] + "0, ...").rename(
        columns={"difference_low": "low", "difference_high": "high"}
    )
    header, rows = pivot(named, format_difference, rank_rows(named, "difference"), "series")
    caption = (
        f"Mean PSNR in dB ({scores.convention}) of a series of trainings minus that of the "
        f"trainings of {BASE}. Brackets: 95 % interval of Welch's t-test over trainings, bold if "
        f"one leads; {HOLM_MARK} marks a lead that Holm's correction takes away. The "
        "interval holds for these clips; other clips would differ too."
    )
    title = f"Trainings minus those of {BASE} [dB]"
    return Table(title, caption, header, rows)


def _lists(scores: Scores, records: pd.DataFrame) -> dict[str, list[str]]:
    listed = set(records["series"])
    methods = set(scores.rows["method"])
    return {
        "Trained once, not listed": sorted(
            method for method in methods if training_series_of(method) not in listed
        ),
        "Left out of the means": scores.incomplete_groups,
        "Not run": scores.skip_reasons,
        "Remarks": scores.remarks,
    }
