"""Steps from one row to the next: their differences add up, and are paired."""

from __future__ import annotations

import pandas as pd
import pytest

from reports import waterfall
from reports.analysis.aggregate import Scores
from reports.layout.step_bars import draw_steps
from rlbench.benchmark.results import MissingRowsError, to_dataframe
from tests.reports.conftest import METHODS, rows

NAMES = {"oidn": "oidn", "ntas": "accumulate", "ours/latent-small": "ours", "ours": "ours/latent"}


@pytest.fixture(scope="module")
def table():
    named = to_dataframe(rows(list(NAMES)))
    return named.assign(method=named["method"].map(NAMES))


@pytest.fixture(scope="module")
def steps(table):
    return waterfall.measure_steps(Scores(table), draws=100)


def test_rows_that_were_not_scored_are_passed_over(steps):
    single = steps[(steps["target_spp"] == 1) & (steps["step"] != "all")]
    assert single["before"].tolist() == ["oidn", "accumulate", "ours"]
    assert single["method"].tolist() == ["accumulate", "ours", "ours/latent"]


def test_a_step_is_the_paired_difference(steps):
    first = steps[(steps["target_spp"] == 1) & (steps["method"] == "accumulate")].iloc[0]
    assert first["difference"] == pytest.approx(METHODS["ntas"][0] - METHODS["oidn"][0])
    assert first["low"] <= first["difference"] <= first["high"]


def test_the_steps_add_up_to_the_whole_way(steps):
    for _, part in steps.groupby("target_spp"):
        single, whole = part[part["step"] != "all"], part[part["step"] == "all"]
        assert single["difference"].sum() == pytest.approx(whole["difference"].iloc[0])


def test_each_bar_begins_where_the_one_before_ends(steps):
    figure = draw_steps(steps, waterfall.STEPS, "caption")
    bars = figure.axes[0].patches
    ends = [bar.get_x() + bar.get_width() for bar in bars]
    assert [bar.get_x() for bar in bars[1:3]] == pytest.approx(ends[:2])
    assert (bars[3].get_x(), ends[3]) == pytest.approx((bars[0].get_x(), ends[2]))


def test_a_page_and_a_figure_are_written(table, tmp_path):
    files = waterfall.write(table, tmp_path, draws=100)
    assert [f.suffix for f in files] == [".md", ".csv", ".tex", ".png", ".pdf", ".svg"]
    page = files[0].read_text()
    assert "| accumulate - oidn |" in page
    assert "| all: ours/latent - oidn |" in page
    assert len(pd.read_csv(files[1])) == 4 * 5


def test_two_rows_are_no_waterfall(table, tmp_path):
    few = table[table["method"].isin(["oidn", "ours"])]
    with pytest.raises(MissingRowsError, match="fewer than 3 of oidn, oidn/tuned"):
        waterfall.write(few, tmp_path)
