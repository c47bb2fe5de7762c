"""What each part of `ours` gives, from formulas with a closed form."""

from __future__ import annotations

import pytest

from reports import parts
from rlbench import registry
from rlbench.benchmark.results import MissingRowsError
from tests.reports.formula_results import Formula, table

FORMULAS = {  # 2 ms a sample
    "ours": Formula(26.0, 1.0, 10.0),
    "ours/by-rule": Formula(25.75, 1.0, 8.0, by_scene=0.1),
    "accumulate/contrast": Formula(26.5, 1.0, 90.0),
    "ntas": Formula(24.0, 1.0, 9.0),
}


@pytest.fixture(scope="module")
def rows():
    rows = table(FORMULAS)
    is_first = (rows["frame"] == 0) & (rows["metric"] == "psnr")
    is_rule = rows["method"] == "ours/by-rule"
    rows.loc[is_first & is_rule, "value"] += 2.0
    return rows


@pytest.fixture(scope="module")
def page(rows, tmp_path_factory):
    return parts.write(rows, tmp_path_factory.mktemp("parts"), draws=100)[0].read_text()


def cells(page, title, start):
    section = page[page.index(f"### {title}\n") :]
    line = next(x for x in section.splitlines() if x.startswith(f"| {start}"))
    return [cell.strip(" *") for cell in line.split("|")[2:-1]]


def test_a_row_is_compared_at_equal_samples(page):
    assert cells(page, "Equal samples", "ours/by-rule")[0].startswith("+0.75 [")  # -0.25 + 2 / 2


def test_a_row_that_saves_time_draws_more_samples(page):
    samples = cells(page, "Samples at equal time", "ours/by-rule")
    assert samples == ["2.00", "3.00", ">= 4.00"]  # 10 + 2 x 1 = 8 + 2 x 2; 5 would fit
    assert cells(page, "Equal time", "ours/by-rule")[0].startswith("+1.75 [")  # a doubling more


def test_a_row_that_takes_longer_than_the_frame_has_no_budget(page):
    section = page[page.index("### Equal time") : page.index("### First frame")]
    assert "accumulate/contrast" not in section


def test_the_first_frame_is_compared_by_itself(page):
    assert cells(page, "First frame", "ours/by-rule")[0].startswith("+1.75 [")  # -0.25 + 2
    assert cells(page, "First frame", "accumulate/contrast")[0].startswith("+0.50")


def test_other_rows_stay_out_and_absent_rows_are_named(page):
    assert "ntas" not in page
    assert "- oidn/tuned: memory and density" in page


def test_without_times_equal_samples_and_the_first_frame_remain(rows, tmp_path):
    page = parts.write(rows[rows["metric"] == "psnr"], tmp_path, draws=100)[0].read_text()
    assert "### Equal samples" in page
    assert "### First frame" in page
    assert "### Equal time" not in page


@pytest.mark.parametrize("methods", [["ours", "ntas"], ["ours/by-rule"], ["ntas"]])
def test_results_without_ours_and_a_part_are_refused(rows, methods, tmp_path):
    with pytest.raises(MissingRowsError, match="rlbench run -m ours,ours/by-rule"):
        parts.write(rows[rows["method"].isin(methods)], tmp_path)


@pytest.mark.parametrize("row", [parts.BASE, *parts.PARTS])
def test_every_part_is_a_row_of_the_registry(row):
    assert registry.get_variant(row)
