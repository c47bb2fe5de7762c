"""Table 1 anew: what a hand computes of a made-up table, and what is missing told."""

from __future__ import annotations

import math
from dataclasses import replace

import pandas as pd
import pytest
from conftest import METHODS, SCENES, rows

from reports import table1
from reports.published import published
from rlbench.benchmark.results import MissingRowsError, to_dataframe

OFFSET = sum(SCENES.values()) / 4


def written(table, folder):
    return [file.read_text() for file in table1.write(table, folder, draws=200)]


@pytest.fixture(scope="module")
def page(results, tmp_path_factory):
    return written(results, tmp_path_factory.mktemp("table1"))[0]


@pytest.fixture(scope="module")
def compared(results):
    return table1.compared(results, draws=200).set_index(["method", "target_spp"])


def line(page, method):
    found = next(x for x in page.splitlines() if x.startswith(f"| {method} |"))
    return [cell.strip(" *") for cell in found.split("|")[1:-1]]


def psnr(method, spp):
    return METHODS[method][0] + METHODS[method][1] * math.log2(spp) + OFFSET


def test_markdown_csv_and_latex_are_written(results, tmp_path):
    files = table1.write(results, tmp_path, draws=10)
    assert [file.name for file in files] == ["table1.md", "table1.csv", "table1.tex"]


@pytest.mark.parametrize("method", METHODS)
def test_a_line_has_the_mean_at_each_budget(page, method):
    found = [float(cell) for cell in line(page, method)[1:6]]
    assert found == pytest.approx([psnr(method, s) for s in (0.5, 1, 2, 4, 8)], abs=0.0051)


@pytest.mark.parametrize(
    ("method", "stated"), [("ntas", (27.7, -1.0, 17.4)), ("mean", (17, -11.7, 0))]
)
def test_a_line_ends_with_what_the_paper_states(page, method, stated):
    assert [float(cell) for cell in line(page, method)[-3:]] == pytest.approx(stated)


def test_inference_is_plan_and_denoise(page):
    assert float(line(page, "ours/small")[7]) == pytest.approx(2.2 + 4.5)


def test_the_difference_is_paired_with_ours(compared):
    row = compared.loc[("ours/small", 4.0)]
    assert row["difference"] == pytest.approx(29.2 - 29.9 + 2 * (1.1 - 1.15))


def test_the_interval_of_one_scene_is_that_of_its_clips():
    city = to_dataframe([r for r in rows(["ours", "ntas"]) if r.scene == "city"])
    row = table1.compared(city, draws=500).set_index(["method", "target_spp"]).loc[("ntas", 1.0)]
    half = 12.7062 * 0.06  # Student's t of its two clips, which have -1.36 and -1.24
    assert (row["low"], row["high"]) == pytest.approx((-1.3 - half, -1.3 + half), rel=1e-4)


def test_a_difference_that_excludes_zero_is_bold_and_one_that_holds_it_is_not(tmp_path):
    ours = [r for r in rows(["ours"]) if r.metric == "psnr"]
    ends = {clip: 1 - 2 * (i // 2 % 2) for i, clip in enumerate(sorted({r.clip for r in ours}))}
    tied = [replace(r, method="ntas", value=r.value + ends[r.clip]) for r in ours]
    worse = [replace(r, method="oidn", value=r.value - 3) for r in ours]
    page = written(to_dataframe([*ours, *tied, *worse]), tmp_path)[0]
    bold = [x for x in page.splitlines() if "**" in x]
    assert [x.split(" | ")[0] for x in bold] == ["| oidn"]


def test_the_orders_are_compared_at_the_papers_budget(results):
    # of ten pairs one is the other way round: ntas and ours/small; 10 of 120 orders are as near
    found = table1.orders(table1.compared(results, draws=10).reset_index())
    assert (found.rows, found.tau, found.chance) == pytest.approx((5, 0.8, 10 / 120))


def test_rows_stand_as_in_the_paper_and_strangers_after_them(tmp_path):
    strange = [replace(r, method="eaw") for r in rows(["ours"])]
    page = written(to_dataframe([*strange, *rows(["mean", "ours"])]), tmp_path)[0]
    lines = [x.split("|")[1].strip() for x in page.splitlines() if x.startswith("| ")]
    assert lines == ["method", "---", "ours", "mean", "eaw"]
    assert line(page, "eaw")[-3:] == ["-", "-", "-"]


def test_what_of_the_paper_is_not_here_is_listed(page):
    assert "- IMCD, here imcd\n" in page
    assert "- ours-A1, here ours/A1\n" in page


@pytest.mark.parametrize("kind", [0, 2])
def test_the_page_warns_that_columns_cannot_be_compared(results, tmp_path, kind):
    text = written(results, tmp_path)[kind]
    assert "cannot be compared with each other" in text


def test_without_ours_the_differences_are_told_to_be_missing(tmp_path):
    page = written(to_dataframe(rows(["ntas", "mean"])), tmp_path)[0]
    assert "differences: 'ours' was not measured on every scene" in page
    assert line(page, "ntas")[6] == "-"


def test_without_the_papers_budget_that_is_told(tmp_path):
    page = written(to_dataframe([r for r in rows(["ours", "mean"]) if r.target_spp < 4]), tmp_path)[
        0
    ]
    assert "- 4 spp, the paper's budget" in page
    assert "The orders were not compared: 0 rows are in both." in page


def test_a_method_that_lacks_a_scene_is_told_and_not_averaged(tmp_path):
    made = [r for r in rows(["ours", "ntas"]) if r.method == "ours" or r.scene != "hall"]
    page = written(to_dataframe(made), tmp_path)[0]
    assert "- ntas at 4 spp: no psnr on hall" in page
    assert "\n| ntas" not in page


def test_rows_of_named_weights_are_told_and_left_out(tmp_path):
    named = [replace(r, method="ours@seed1") for r in rows(["ours"])]
    page = written(to_dataframe([*rows(["ours"]), *named]), tmp_path)[0]
    assert "### Left out, as they ran with named weights\n\n- ours@seed1" in page
    assert "\n| ours@seed1" not in page


def test_a_table_without_any_row_of_the_paper_is_refused(tmp_path):
    strange = to_dataframe([replace(r, method="mine") for r in rows(["ours"])])
    with pytest.raises(MissingRowsError, match="results are of: mine"):
        table1.write(strange, tmp_path)


def test_a_device_without_rows_of_the_paper_keeps_no_other_from_its_table(tmp_path):
    strange = [replace(row, method="mine") for row in rows(["ntas"], device="H100")]
    page = table1.write(to_dataframe(rows(["ours"]) + strange), tmp_path)[0].read_text()
    assert "## NVIDIA RTX 2080 Ti" in page
    assert "H100" not in page


def test_named_weights_on_more_scenes_keep_no_row_out_of_the_table(tmp_path):
    some = [row for row in rows(["ours"]) if row.scene in ("city", "hall")]
    named = [replace(row, method="ours@seed0") for row in rows(["ours"])]
    assert "\n| ours |" in table1.write(to_dataframe(some + named), tmp_path)[0].read_text()


def test_the_csv_has_a_row_for_each_method_and_budget(results, tmp_path):
    table1.write(results, tmp_path, draws=10)
    found = pd.read_csv(tmp_path / "table1.csv")
    assert len(found) == len(METHODS) * 5
    assert set(found["device"]) == {"NVIDIA RTX 2080 Ti"}


def test_each_device_has_a_section(tmp_path):
    mixed = to_dataframe(rows(["ours"]) + rows(["ntas"], device="H100"))
    page = written(mixed, tmp_path)[0]
    assert page.count(f"### Table 1 of {published().title}") == 2


def test_latex_escapes_what_it_must(results, tmp_path):
    tex = written(results, tmp_path)[2]
    assert r"95 \% interval" in tex
    assert r"ours/small & " in tex
