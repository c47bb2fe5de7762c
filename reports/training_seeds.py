"""How much a row's score depends on the seed of its training, beside what the paper states."""

from __future__ import annotations

from pathlib import Path

import pandas as pd

from reports.analysis import aggregate, method_names
from reports.analysis.correlation import std_with_interval
from reports.analysis.training_differences import BASE, differences_to
from reports.layout import page
from reports.layout.tables import Grid, gap_text, wide
from reports.published import published
from rlbench.benchmark.results import MissingRowsError

METRIC = "psnr"


def write(table: pd.DataFrame, folder: Path, name: str = "seeds") -> list[Path]:
    """`name`.md, .csv and .tex: for each row that was trained several times, a line a budget.

    Trainings alike are rows whose names differ in the number at the end of their weights' name
    alone: ours@seed0, ours@seed1, ... Raises LacksError without two of them, and ReportError where
    two have the same weights.
    """
    sections = []
    for device, rows in aggregate.by_device(table).items():
        trained = rows[rows["method"].map(method_names.training_series) != ""]
        found = deviations(trained)
        if len(found):
            aggregate.check(trained)
            grids = [_grid(trained, found, device)]
            differ = differences_to(_means(trained))
            grids += [_difference_grid(trained, differ)] if len(differ) else []
            both = found.merge(differ, on=["series", "target_spp"], how="left")
            sections.append(page.Section(device, grids, both, _lists(trained, found)))
    if not sections:
        have = sorted({method for method in table["method"] if method_names.weights(method)})
        raise MissingRowsError(
            "no row was scored with two trainings; it takes rows such as ours@seed0 and ours@seed1,"
            f" and rows of named weights are: {', '.join(have) or 'none'}"
        )
    return page.write(folder, name, "Seeds of training", table, sections)


def deviations(table: pd.DataFrame) -> pd.DataFrame:
    """A row for each series of trainings and budget: the mean over scenes of each, their spread.

    `deviation` is the standard deviation of n - 1, `low` and `high` its 95 % chi-square interval.
    Trainings that lack a scene at a budget are left out of it, and a budget with fewer than two is.
    """
    _differ(table)
    made = []
    means = _means(table)
    for series, trained in means.groupby(means["method"].map(method_names.training_series)):
        made += [{"series": series, **row} for row in _spread(trained)]
    return pd.DataFrame(made)


def _means(table: pd.DataFrame) -> pd.DataFrame:
    return aggregate.overall(aggregate.scene_means(table, METRIC))


def _spread(means: pd.DataFrame) -> list[dict[str, object]]:
    made = []
    for spp, part in means.groupby("target_spp"):
        if len(part) < 2:
            continue
        found = std_with_interval(list(part["value"]))
        made.append(
            {
                "target_spp": spp,
                "mean": part["value"].mean(),
                "deviation": found.value,
                "low": found.low,
                "high": found.high,
                "least": part["value"].min(),
                "most": part["value"].max(),
                "trainings": found.count,
            }
        )
    return made


def _differ(table: pd.DataFrame) -> None:
    """Raise ReportError where two trainings of a series are one: their weights are the same."""
    known = table[
        (table["metric"] == METRIC) & table["value"].notna() & (table["weights_hash"] != "")
    ]
    known = known.drop_duplicates(["method", "weights_hash"])
    for (_, weights), part in known.groupby(
        [known["method"].map(method_names.training_series), "weights_hash"]
    ):
        if len(part) > 1:
            raise aggregate.ReportError(
                f"{' and '.join(sorted(part['method']))} ran with the same weights ({weights}); "
                "a deviation between trainings needs weights of different seeds"
            )


def _grid(table: pd.DataFrame, found: pd.DataFrame, device: str) -> Grid:
    paper = published()
    body = tuple(
        (
            f"{row['series']}0, ...",
            f"{row['target_spp']:g}",
            f"{row['trainings']}",
            f"{row['mean']:.2f}",
            f"{row['deviation']:.3f} [{row['low']:.3f}, {row['high']:.3f}]",
            f"{row['least']:.2f} to {row['most']:.2f}",
            f"{paper.deviation_db:g}"
            if method_names.row(row["series"]) == paper.deviation_row
            else "-",
        )
        for row in found.to_dict("records")
    )
    head = ("trainings of", "spp", "number", "mean", "deviation", "range", "paper")
    caption = (
        f"PSNR in dB ({aggregate.column_text(table, METRIC, 'convention')})"
        f", mean over scenes, of trainings "
        "that differ in their seed alone. Deviation: standard deviation (n - 1) and its 95 % "
        "interval by chi-square, which takes the trainings to be normal. Paper: "
        f"{paper.deviation_db:g} dB from {paper.trainings} trainings, budget not said "
        f"({paper.title}). Scored on {device or 'a device not named'}."
    )
    return Grid("Deviation between seeds of training [dB]", caption, head, body)


def _difference_grid(table: pd.DataFrame, differ: pd.DataFrame) -> Grid:
    named = differ.assign(method=differ["series"] + "0, ...")
    (_, *budgets), body = wide(
        named,
        lambda row: gap_text(row["difference"], row["difference_low"], row["difference_high"]),
    )
    caption = (
        f"Mean PSNR in dB ({aggregate.column_text(table, METRIC, 'convention')})"
        f" of a row's trainings less "
        f"that of the trainings of {BASE}. In brackets: 95 % interval by Welch's t-test over "
        "trainings, bold where it excludes zero. It holds for these clips; other clips would "
        "differ too."
    )
    title = f"Trainings less those of {BASE} [dB]"
    return Grid(title, caption, ("trainings of", *budgets), tuple(body))


def _lists(table: pd.DataFrame, found: pd.DataFrame) -> dict[str, list[str]]:
    shown = set(found["series"])
    single = sorted({m for m in table["method"] if method_names.training_series(m) not in shown})
    return {
        "Trained once, so not shown": single,
        "Left out of the means": aggregate.incomplete_groups(table, METRIC),
        "Not run": aggregate.reasons(table[table["metric"] == METRIC]),
        "Remarks": aggregate.remarks(table[table["metric"] == METRIC]),
    }
