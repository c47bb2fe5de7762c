"""Table 1 measured again: numbers computed by hand, and lists of what is missing."""

from __future__ import annotations

import math
from dataclasses import replace

import pandas as pd
import pytest

from reports import table1
from reports.analysis.scores import Scores
from reports.published import published
from rlbench.benchmark.results import MissingRowsError, to_dataframe
from tests.reports.conftest import METHODS, SCENES, as_published, rows

OFFSET = sum(SCENES.values()) / 4


def write_and_read(table, folder):
    return [file.read_text() for file in table1.write(table, folder, draws=200)]


@pytest.fixture(scope="module")
def results(published_results):
    """Five methods of the paper's table, and `ours`, whose scores are those of `ours/latent`."""
    return pd.concat([published_results, to_dataframe(rows(["ours"]))], ignore_index=True)


@pytest.fixture(scope="module")
def page(results, tmp_path_factory):
    return write_and_read(results, tmp_path_factory.mktemp("table1"))[0]


@pytest.fixture(scope="module")
def records(results):
    return table1.compare_with_paper(Scores(results), draws=200).set_index(["method", "target_spp"])


def cells(page, method):
    line = next(x for x in page.splitlines() if x.startswith(f"| {method} |"))
    return [cell.strip(" *") for cell in line.split("|")[1:-1]]


def psnr(method, spp):
    return METHODS[method][0] + METHODS[method][1] * math.log2(spp) + OFFSET


def test_markdown_csv_and_latex_are_write_and_read(results, tmp_path):
    files = table1.write(results, tmp_path, draws=10)
    assert [file.name for file in files] == ["table1.md", "table1.csv", "table1.tex"]


@pytest.mark.parametrize("method", METHODS)
def test_a_row_has_the_mean_at_each_budget(page, method):
    means = [float(cell) for cell in cells(page, method)[1:6]]
    assert means == pytest.approx([psnr(method, s) for s in (0.5, 1, 2, 4, 8)], abs=0.0051)


@pytest.mark.parametrize(
    ("method", "printed"), [("ntas", (27.7, -1.0, 17.4)), ("mean", (17, -11.7, 0))]
)
def test_a_row_ends_with_the_published_numbers(page, method, printed):
    """The differences are those to the row of the paper's own method."""
    assert [float(cell) for cell in cells(page, method)[-3:]] == pytest.approx(printed)
    assert cells(page, "method")[-2] == "paper, minus ours/latent"
    assert cells(page, "ours/latent")[-3:] == ["28.7", "-", "22.5"]


def test_inference_is_plan_and_denoise(page):
    assert float(cells(page, "ours/latent-small")[7]) == pytest.approx(2.2 + 4.5)


def test_differences_are_to_ours(records):
    row = records.loc[("ours/latent-small", 4.0)]
    assert row["difference"] == pytest.approx(29.2 - 29.9 + 2 * (1.1 - 1.15))


def test_the_interval_of_one_scene_is_over_its_clips():
    city = to_dataframe([r for r in rows(["ours", "ntas"]) if r.scene == "city"])
    row = (
        table1.compare_with_paper(Scores(city), draws=500)
        .set_index(["method", "target_spp"])
        .loc[("ntas", 1.0)]
    )
    half = 12.7062 * 0.06  # Student's t of its two clips, which have -1.36 and -1.24
    assert (row["low"], row["high"]) == pytest.approx((-1.3 - half, -1.3 + half), rel=1e-4)


def test_a_difference_is_bold_if_its_interval_excludes_zero(tmp_path):
    ours = [r for r in rows(["ours"]) if r.metric == "psnr"]
    ends = {clip: 1 - 2 * (i // 2 % 2) for i, clip in enumerate(sorted({r.clip for r in ours}))}
    tied = [replace(r, method="ntas", value=r.value + ends[r.clip]) for r in ours]
    worse = [replace(r, method="oidn", value=r.value - 3) for r in ours]
    page = write_and_read(to_dataframe([*ours, *tied, *worse]), tmp_path)[0]
    bold = [x for x in page.splitlines() if "**" in x]
    assert [x.split(" | ")[0] for x in bold] == ["| oidn"]


def test_the_orders_are_compared_at_the_papers_budget(results):
    # of ten pairs, ntas and ours/latent-small are reversed; 10 of 120 orders are as far from zero
    records = table1.compare_with_paper(Scores(results), draws=10)
    result = table1.rank_correlation(records)
    assert (result.rows, result.tau, result.p_value) == pytest.approx((5, 0.8, 10 / 120))


def test_the_orders_of_strong_rows_are_compared_apart(results, page):
    """Three of five rows lie within 2 dB of the paper's best; one of their pairs is reversed."""
    records = table1.compare_with_paper(Scores(results), draws=10)
    strong = table1.rank_correlation(records, within_db=2.0)
    assert (strong.rows, strong.tau) == (3, pytest.approx(1 / 3))
    assert "of the 3 that the paper places within 2 dB of its best: Kendall's tau-b 0.33" in page


def test_rows_are_in_the_papers_order_and_other_methods_follow(tmp_path):
    other = [replace(r, method="eaw") for r in rows(["ours"])]
    printed = as_published(rows(["mean", "ours"]))
    page = write_and_read(to_dataframe([*other, *rows(["ours"]), *printed]), tmp_path)[0]
    names = [x.split("|")[1].strip() for x in page.splitlines() if x.startswith("| ")]
    assert names == ["method", "---", "ours/latent", "mean", "eaw", "ours"]
    assert cells(page, "eaw")[-3:] == cells(page, "ours")[-3:] == ["-", "-", "-"]


def test_published_rows_that_were_not_measured_are_listed(page):
    assert "- IMCD, in rlbench imcd\n" in page
    assert "- ours-A1, in rlbench ours/latent-A1\n" in page


@pytest.mark.parametrize("kind", [0, 2])
def test_the_page_warns_not_to_compare_with_the_papers_columns(results, tmp_path, kind):
    text = write_and_read(results, tmp_path)[kind]
    assert "cannot be compared with each other" in text


def test_without_ours_the_missing_differences_are_listed(tmp_path):
    page = write_and_read(to_dataframe(rows(["ntas", "mean"])), tmp_path)[0]
    assert "differences: 'ours' was not measured on every scene" in page
    assert cells(page, "ntas")[6] == "-"


def test_a_missing_budget_of_the_paper_is_listed(tmp_path):
    page = write_and_read(
        to_dataframe([r for r in rows(["ours", "mean"]) if r.target_spp < 4]), tmp_path
    )[0]
    assert "- 4 spp, the paper's budget" in page
    assert "The orders were not compared: 0 rows are in both." in page


def test_a_method_that_lacks_a_scene_is_listed_without_a_mean(tmp_path):
    incomplete = [r for r in rows(["ours", "ntas"]) if r.method == "ours" or r.scene != "hall"]
    page = write_and_read(to_dataframe(as_published(incomplete)), tmp_path)[0]
    assert "- ntas at 4 spp: no psnr on hall" in page
    assert "\n| ntas" not in page


def test_rows_with_a_label_are_left_out_and_listed(tmp_path):
    labelled = [replace(r, method="ours/latent@seed1") for r in rows(["ours"])]
    page = write_and_read(to_dataframe([*as_published(rows(["ours"])), *labelled]), tmp_path)[0]
    assert "### Left out: other weights or precision\n\n- ours/latent@seed1" in page
    assert "\n| ours/latent@seed1" not in page


def test_results_without_a_method_of_the_paper_are_refused(tmp_path):
    other = to_dataframe([replace(r, method="mine") for r in rows(["ours"])])
    with pytest.raises(MissingRowsError, match="methods in the results: mine"):
        table1.write(other, tmp_path)


def test_a_device_without_published_rows_has_no_section(tmp_path):
    other = [replace(row, method="mine") for row in rows(["ntas"], device="H100")]
    table = to_dataframe(as_published(rows(["ours"])) + other)
    page = table1.write(table, tmp_path)[0].read_text()
    assert "## NVIDIA RTX 2080 Ti" in page
    assert "H100" not in page


def test_labelled_rows_on_more_scenes_keep_no_row_out_of_the_table(tmp_path):
    some = [row for row in as_published(rows(["ours"])) if row.scene in ("city", "hall")]
    labelled = [replace(row, method="ours/latent@seed0") for row in rows(["ours"])]
    page = table1.write(to_dataframe(some + labelled), tmp_path)[0].read_text()
    assert "\n| ours/latent |" in page


def test_the_csv_has_a_row_for_each_method_and_budget(results, tmp_path):
    table1.write(results, tmp_path, draws=10)
    csv = pd.read_csv(tmp_path / "table1.csv")
    assert len(csv) == (len(METHODS) + 1) * 5
    assert set(csv["device"]) == {"NVIDIA RTX 2080 Ti"}


def test_each_device_has_a_section(tmp_path):
    mixed = to_dataframe(as_published(rows(["ours"])) + rows(["ntas"], device="H100"))
    page = write_and_read(mixed, tmp_path)[0]
    assert page.count(f"### Table 1 of {published().title}") == 2


def test_latex_escapes_percent_signs(results, tmp_path):
    tex = write_and_read(results, tmp_path)[2]
    assert r"95 \% interval" in tex
    assert r"ours/latent-small & " in tex
