"""Where samples went: histogram of counts, share at the cap, correlation with noise and error."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pandas as pd

from reports.analysis.scores import Scores, mean_over_scenes
from reports.layout.page import Section, write_report
from reports.layout.tables import Table, format_number
from rlbench.benchmark.results import COUNT_PREFIX

KEYS = ["method", "target_spp"]
CORRELATIONS = ["effort_noise", "effort_error"]
AT_CAP = "at_cap"
ALL = 99.995  # percent: such a histogram has a single bin, up to rounding


def write(results: pd.DataFrame, folder: Path, name: str = "effort") -> list[Path]:
    """Write where adaptive methods drew their samples, see `write_report`."""
    missing = (
        "no row has pixels with different numbers of samples. Score an adaptive method with "
        "rlbench run"
    )
    return write_report(results, folder, name, "Effort", _section, missing)


def _section(scores: Scores) -> Section | None:
    shares = count_shares(scores)
    if shares.empty:
        return None
    effort = measure_effort(scores).merge(shares[KEYS], on=KEYS)
    tables = [_histogram(shares), _summary(effort)]
    return Section(scores.device, tables, shares.merge(effort, on=KEYS))


def count_shares(scores: Scores) -> pd.DataFrame:
    """Share of pixels with 0, 1, ... samples in percent, mean over scenes; columns `0`, `1`, ...

    One row for each method and budget that gives its pixels different numbers of samples.
    """
    names = {name for name in scores.rows["metric"] if name.startswith(COUNT_PREFIX)}
    bins = sorted((name.removeprefix(COUNT_PREFIX) for name in names), key=int)
    if not bins:
        return pd.DataFrame(columns=KEYS)
    shares = _means(scores, [f"{COUNT_PREFIX}{count}" for count in bins])
    shares = shares.rename(columns=lambda name: name.removeprefix(COUNT_PREFIX))
    shares = shares[shares["0"].notna()].fillna(0.0)  # a smaller cap has no bins above it
    return shares[shares[bins].max(axis=1) < ALL].reset_index(drop=True)


def measure_effort(scores: Scores) -> pd.DataFrame:
    """Correlations and the share at the cap, mean over scenes, and that share of each scene.

    Columns method, target_spp, effort_noise, effort_error, at_cap, and `at_cap SCENE`.
    """
    caps = replace(scores, metric=AT_CAP).scene_means
    scenes = caps.pivot_table("value", KEYS, "scene").add_prefix(f"{AT_CAP} ").reset_index()
    return _means(scores, [*CORRELATIONS, AT_CAP]).merge(scenes, on=KEYS, how="left")


def _means(scores: Scores, metrics: list[str]) -> pd.DataFrame:
    """Mean over scenes of each metric, one column each."""
    table = scores.rows[KEYS].drop_duplicates()
    for metric in metrics:
        means = mean_over_scenes(replace(scores, metric=metric).scene_means)
        table = table.merge(means.rename(columns={"value": metric}), on=KEYS, how="left")
    return table.sort_values(KEYS).reset_index(drop=True)


def _histogram(shares: pd.DataFrame) -> Table:
    bins = [str(column) for column in shares.columns.drop(KEYS)]
    caption = (
        "Share of pixels in percent with so many samples, pilot samples included, over all frames; "
        "mean over scenes. Rows that give all pixels the same number are left out."
    )
    return _table(
        "Histogram of sample counts [%]", caption, shares, {name: name for name in bins}, ".1f"
    )


def _summary(effort: pd.DataFrame) -> Table:
    names = [column for column in effort.columns if column.startswith(f"{AT_CAP} ")]
    columns = {
        "effort_noise": "samples and noise",
        "effort_error": "samples and error",
        AT_CAP: "at the cap [%]",
        **{name: f"at the cap, {name.removeprefix(f'{AT_CAP} ')} [%]" for name in names},
    }
    caption = (
        "Rank correlation of sample counts with the noise of the scene, and with the error that is "
        "left; share of pixels with as many samples as the clip has, or as the method allows, mean "
        "over scenes and scene by scene. Scardigli et al. 2023 report fewer than 0.6 % at 8."
    )
    return _table("Samples, noise and error", caption, effort, columns, ".2f")


def _table(
    title: str, caption: str, records: pd.DataFrame, columns: dict[str, str], number_format: str
) -> Table:
    rows = tuple(
        (
            str(record["method"]),
            f"{record['target_spp']:g}",
            *(format_number(record[column], number_format) for column in columns),
        )
        for record in records.to_dict("records")
    )
    return Table(title, caption, ("method", "spp", *columns.values()), rows)
