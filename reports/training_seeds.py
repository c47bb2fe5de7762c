"""The deviation of scores between trainings with different seeds, beside the published one."""

from __future__ import annotations

from pathlib import Path

import pandas as pd

from reports.analysis.aggregate import Scores, mean_over_scenes
from reports.analysis.comparability import ReportError, check_comparable, split_by_device
from reports.analysis.correlation import std_with_interval
from reports.analysis.method_names import label_of, training_series_of, without_label
from reports.analysis.training_differences import BASE, differences_to
from reports.analysis.verdicts import HOLM_MARK
from reports.layout.page import Section, write_page
from reports.layout.tables import Table, format_difference, pivot_by_budget, rank_rows
from reports.published import published
from rlbench.benchmark.results import MissingRowsError

__all__ = ["deviations", "write"]


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
        "deviation": deviation.value,
        "low": deviation.low,
        "high": deviation.high,
        "least": values.min(),
        "most": values.max(),
        "trainings": deviation.count,
    }


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
    (_, *budgets), rows = pivot_by_budget(named, format_difference, rank_rows(named, "difference"))
    caption = (
        f"Mean PSNR in dB ({scores.convention}) of a series of trainings minus that of the "
        f"trainings of {BASE}. Brackets: 95 % interval of Welch's t-test over trainings, bold if "
        f"one leads; {HOLM_MARK}: not after Holm's correction for this table. The interval holds "
        "for these clips; other clips would differ too."
    )
    title = f"Trainings minus those of {BASE} [dB]"
    return Table(title, caption, ("series", *budgets), tuple(rows))


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
