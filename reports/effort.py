"""Where samples went: histogram of counts, share at the cap, correlation with noise and error."""

from __future__ import annotations

from pathlib import Path

import pandas as pd

from reports.analysis.aggregate import Scores, mean_over_scenes
from reports.analysis.comparability import check_comparable, split_by_device
from reports.layout.page import Section, write_page
from reports.layout.tables import Table
from rlbench.benchmark.results import COUNT_PREFIX, MissingRowsError

__all__ = ["count_shares", "measure_effort", "write"]

KEYS = ["method", "target_spp"]
CORRELATIONS = ["effort_noise", "effort_error"]
AT_CAP = "at_cap"
ALL = 99.995  # percent: such a histogram has a single bin, up to rounding


def write(results: pd.DataFrame, folder: Path, name: str = "effort") -> list[Path]:
    """Write `name`.md, .csv and .tex: where adaptive methods drew their samples.

    Raises MissingRowsError if no row adapts, or has a histogram of sample counts.
    """
    sections = []
    for device, rows in split_by_device(results).items():
        check_comparable(rows)
        shares = count_shares(rows)
        if shares.empty:
            continue
        effort = measure_effort(rows).merge(shares[KEYS], on=KEYS)
        records = shares.merge(effort, on=KEYS)
        tables = [_histogram(shares), _summary(effort)]
        sections.append(Section(device, tables, records))
    if not sections:
        raise MissingRowsError(
            "no row has pixels with different numbers of samples. Score an adaptive method with "
            "rlbench run; results of earlier versions have no histogram of sample counts"
        )
    return write_page(folder, name, "Effort", results, sections)


def count_shares(rows: pd.DataFrame) -> pd.DataFrame:
    """Share of pixels with 0, 1, ... samples in percent, mean over scenes; columns `0`, `1`, ...

    One row for each method and budget that gives its pixels different numbers of samples.
    """
    names = sorted(
        {metric for metric in rows["metric"] if metric.startswith(COUNT_PREFIX)}, key=_count
    )
    if not names:
        return pd.DataFrame(columns=KEYS)
    shares = _means(rows, names).rename(columns=lambda name: name.removeprefix(COUNT_PREFIX))
    shares = shares[shares["0"].notna()].fillna(0.0)  # a smaller cap has no bins above it
    bins = [str(_count(name)) for name in names]
    return shares[shares[bins].max(axis=1) < ALL].reset_index(drop=True)


def measure_effort(rows: pd.DataFrame) -> pd.DataFrame:
    """Correlations and the share at the cap, mean over scenes, and that share of each scene.

    Columns method, target_spp, effort_noise, effort_error, at_cap, and `at_cap SCENE`.
    """
    caps = Scores(rows, AT_CAP).scene_means
    scenes = caps.pivot_table("value", KEYS, "scene").add_prefix(f"{AT_CAP} ").reset_index()
    return _means(rows, [*CORRELATIONS, AT_CAP]).merge(scenes, on=KEYS, how="left")


def _count(metric: str) -> int:
    return int(metric.removeprefix(COUNT_PREFIX))


def _means(rows: pd.DataFrame, metrics: list[str]) -> pd.DataFrame:
    """Mean over scenes of each metric, one column each."""
    table = pd.DataFrame({key: rows[key] for key in KEYS}).drop_duplicates()
    for metric in metrics:
        means = mean_over_scenes(Scores(rows, metric).scene_means)
        table = table.merge(means.rename(columns={"value": metric}), on=KEYS, how="left")
    return table.sort_values(KEYS).reset_index(drop=True)


def _histogram(shares: pd.DataFrame) -> Table:
    bins = [str(column) for column in shares.columns.drop(KEYS)]
    caption = (
        "Share of pixels in percent with so many samples, pilot samples included, over all frames; "
        "mean over scenes. Rows that give all pixels the same number are left out."
    )
    return _table("Histogram of sample counts [%]", caption, shares, bins, bins, 1)


def _summary(effort: pd.DataFrame) -> Table:
    scenes = [column for column in effort.columns if column.startswith(f"{AT_CAP} ")]
    names = [f"at the cap, {column.removeprefix(f'{AT_CAP} ')} [%]" for column in scenes]
    header = ["samples and noise", "samples and error", "at the cap [%]", *names]
    caption = (
        "Rank correlation of sample counts with the noise of the scene, and with the error that is "
        "left; share of pixels with as many samples as the clip has, or as the method allows, mean "
        "over scenes and scene by scene. Scardigli et al. 2023 report fewer than 0.6 % at 8."
    )
    columns = [*CORRELATIONS, AT_CAP, *scenes]
    return _table("Samples, noise and error", caption, effort, columns, header, 2)


def _table(
    title: str,
    caption: str,
    records: pd.DataFrame,
    columns: list[str],
    header: list[str],
    digits: int,
) -> Table:
    rows = tuple(
        (
            str(record["method"]),
            f"{record['target_spp']:g}",
            *("-" if record[c] != record[c] else f"{record[c]:.{digits}f}" for c in columns),
        )
        for record in records.to_dict("records")
    )
    return Table(title, caption, ("method", "spp", *header), rows)
