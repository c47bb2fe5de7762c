"""Tables as Markdown and LaTeX: escaped, aligned, ranked, and no wider than a page."""

from __future__ import annotations

import re
import shutil
import subprocess

import pandas as pd
import pytest

from reports.layout.latex import MAX_ROWS, PREAMBLE, to_latex
from reports.layout.page import MAX_LINES, Section, write_page
from reports.layout.tables import Bold, Table, rank_rows, to_markdown

BUDGETS = tuple(f"{spp} spp" for spp in range(6))
CELLS = (Bold("21.50"), "9.25 [-1.00, 0.10] not resolved", "-")


def test_latex_escapes_its_special_characters():
    table = Table("50 % of a_b", "x & y", ("m", "v"), (("a_b", Bold("1")),))
    text = to_latex(table)
    assert r"\caption{50 \% of a\_b. x \& y}" in text
    assert r"a\_b & \bfseries 1 \\" in text


def test_markdown_escapes_the_bar_between_columns():
    assert "| a\\|b | **1** |" in to_markdown(Table("t", "c", ("m", "v"), (("a|b", Bold("1")),)))


def test_numbers_are_aligned_at_the_decimal_point_and_their_intervals_beside_them():
    text = to_latex(Table("t", "c", ("m", "1 spp"), tuple(("a", cell) for cell in CELLS)))
    assert r"\begin{tabular}{lS[table-format=2.2]@{\,}l}" in text
    assert r"m & \multicolumn{2}{c}{1 spp} \\" in text
    assert r"a & 9.25 & {\scriptsize [-1.00, 0.10] not resolved} \\" in text


def wide_table():
    rows = tuple((f"accumulate/{i}", *[CELLS[1]] * 6) for i in range(MAX_ROWS + 1))
    return Table("t", "c", ("method", *BUDGETS), rows)


def test_a_wide_table_is_split_by_columns_and_a_long_one_by_rows():
    text = to_latex(wide_table())
    assert text.count(r"\begin{table}") == 6  # three of columns, two of rows
    assert all(text.count(f"{{{budget}}}") == 2 for budget in BUDGETS)
    assert text.count("t, continued.") == 5


@pytest.mark.skipif(not shutil.which("pdflatex"), reason="needs pdflatex")
def test_latex_compiles_and_no_line_leaves_the_page(tmp_path):
    packages = re.sub("^% ", "", PREAMBLE, flags=re.MULTILINE)
    rows = tuple((f"a_{i}", cell, "1.5?", "city") for i, cell in enumerate(CELLS))
    body = to_latex(
        Table("50 %", "c", ("method", "1 spp", "ms", "scene"), rows, "note")
    ) + to_latex(wide_table())
    start, end = r"\documentclass{article}", r"\end{document}"
    (tmp_path / "t.tex").write_text(f"{start}\n{packages}\\begin{{document}}\n{body}{end}")
    command = ["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "t.tex"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-2000:]
    assert "Overfull" not in done.stdout


def test_methods_are_ranked_at_the_budget_nearest_to_one_that_most_have():
    table = pd.DataFrame(
        [("a", 0.5, 9.0), ("a", 2.0, 1.0), ("b", 2.0, 2.0), ("c", 8.0, 3.0), ("b", 8.0, 0.0)],
        columns=["method", "target_spp", "psnr"],
    )
    assert rank_rows(table, "psnr") == ["b", "a", "c"]
    assert rank_rows(table, "psnr", "lower") == ["a", "b", "c"]


def page_of(tmp_path, tables, lists):
    results = pd.DataFrame({"preset": ["mini"], "clip": ["x"], "frame": [0], "run_id": ["r"]})
    section = Section("cpu", tables, pd.DataFrame(), lists)
    return [file.read_text() for file in write_page(tmp_path, "p", "P", results, [section])]


def test_a_note_that_tables_share_is_printed_once(tmp_path):
    table = Table("t", "", ("m", "v"), (("a", "1"),), "Brackets: an interval.")
    markdown, _, latex = page_of(tmp_path, [table, table], {})
    assert markdown.count("Brackets") == latex.count("Brackets") == 1


def test_a_long_list_is_folded_below_the_number_of_its_entries(tmp_path):
    lines = [f"line {i}" for i in range(MAX_LINES + 1)]
    markdown = page_of(tmp_path, [], {"Not run": lines, "Remarks": lines[:2]})[0]
    assert f"<summary>{len(lines)} entries</summary>\n\n- line 0" in markdown
    assert "### Remarks\n\n- line 0\n- line 1\n" in markdown
