"""Tables as Markdown and LaTeX, pages, styles, labels of curves, files that appear whole."""

from __future__ import annotations

import re
import shutil
import subprocess

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure
from scipy.optimize import isotonic_regression

from reports.layout.curve_labels import label_curves, label_width, longest_rise, spread_labels
from reports.layout.latex import MAX_ROWS, PREAMBLE, to_latex
from reports.layout.page import MAX_LINES, Section, write_page
from reports.layout.style import FAMILY_COLOURS, line_styles
from reports.layout.tables import Bold, Table, rank_rows, to_markdown
from rlbench import registry

BUDGETS = tuple(f"{spp} spp" for spp in range(6))
CELLS = (Bold("21.50"), "9.25 [-1.00, 0.10] not resolved", "-")
LINES = tuple((f"accumulate/{i}", *[CELLS[1]] * 6) for i in range(MAX_ROWS + 1))
WIDE = Table("t", "c", ("method", *BUDGETS), LINES)
HOSTILE = "CPU\n\\input{x} $a$ | <script> <!-- [l](http://x) ^^M"


def test_names_of_strangers_stay_text_in_every_format():
    table = Table(HOSTILE, HOSTILE, ("method", HOSTILE), ((HOSTILE, HOSTILE),), note=HOSTILE)
    tex, page = to_latex(table), to_markdown(table)
    assert "\\input" not in tex
    assert "$a$" not in tex
    assert "^^" not in tex
    assert not [line for line in page.splitlines() if line.startswith("\\input")]
    assert "<script" not in page
    assert "<!--" not in page
    assert "](" not in page
    table = Table("50 % of a_b", "x & y", ("m", "v"), (("a_b|c", Bold("1")),))
    assert r"\caption{50 \% of a\_b.}" in to_latex(table)
    assert r"a\_b|c & \bfseries 1 \\" in to_latex(table)
    assert "| a_b\\|c | **1** |" in to_markdown(table)


def test_numbers_are_aligned_at_the_decimal_point_and_their_intervals_beside_them():
    text = to_latex(Table("t", "c", ("m", "1 spp"), tuple(("a", cell) for cell in CELLS)))
    assert r"\begin{tabular}{lS[table-format=2.2]@{\,}l}" in text
    assert r"m & \multicolumn{2}{c}{1 spp} \\" in text
    assert r"a & 9.25 & {\scriptsize [-1.00, 0.10] not resolved} \\" in text


def test_a_wide_table_is_split_by_columns_and_a_long_one_by_rows():
    text = to_latex(WIDE)
    assert text.count(r"\begin{table}") == 6  # three of columns, two of rows
    assert all(text.count(f"{{{budget}}}") == 2 for budget in BUDGETS)
    assert text.count("t, continued.") == 5


@pytest.mark.skipif(not shutil.which("pdflatex"), reason="needs pdflatex")
def test_latex_compiles_and_no_line_leaves_the_page(tmp_path):
    packages = re.sub("^% ", "", PREAMBLE, flags=re.MULTILINE)
    rows = tuple((f"a_{i}", cell, "1.5?", "city") for i, cell in enumerate(CELLS))
    body = to_latex(Table("50 %", "c", ("method", "1 spp", "ms", "scene"), rows, "note"))
    start, end = r"\documentclass{article}", r"\end{document}"
    text = f"{start}\n{packages}\\begin{{document}}\n{body}{to_latex(WIDE)}{end}"
    (tmp_path / "t.tex").write_text(text)
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


def test_a_page_prints_a_shared_note_once_and_folds_long_lists(tmp_path):
    results = pd.DataFrame({"preset": ["mini"], "clip": ["x"], "frame": [0], "run_id": ["r"]})
    table = Table("t", "", ("m", "v"), (("a", "1"),), "Brackets: an interval.")
    lines = [f"line {i}" for i in range(MAX_LINES + 1)]
    lists = {"Not run": lines, "Remarks": lines[:2], "Empty": []}
    section = Section("cpu", [table, table], pd.DataFrame(), lists)
    files = write_page(tmp_path, "p", "P", results, [section])
    markdown, _, latex = (file.read_text() for file in files)
    assert markdown.startswith("# P: preset mini, 1 clip of 1 frame\n")
    assert markdown.count("Brackets") == latex.count("Brackets") == 1
    assert f"<summary>{len(lines)} entries</summary>\n\n- line 0" in markdown
    assert "### Remarks\n\n- line 0\n- line 1\n" in markdown
    assert "### Empty" not in markdown


METHODS = ["ours", "ours/A1", "ours/latent-small", "ntas", "oidn", "mean", "x", "y/b", "y", "z"]


def test_a_family_keeps_its_colour_and_no_two_methods_have_the_same_style():
    styles = line_styles(METHODS)
    assert {styles[n].color for n in METHODS if n.startswith("ours")} == {FAMILY_COLOURS["ours"]}
    assert line_styles(["ours"])["ours"].color == FAMILY_COLOURS["ours"]
    assert len(set(styles.values())) == len(METHODS)
    many = line_styles([f"ours/{number}" for number in range(32)]).values()
    assert len({(style.marker, str(style.dash)) for style in many}) == 32
    families = line_styles(["ours", "ntas", "oidn", "mean", "svgf", "dasr", "imcd", "restir"])
    assert len({style.marker for style in families.values()}) == 8  # also in grey print
    everything = line_styles([*FAMILY_COLOURS, *registry.list_plugins("methods"), "theirs", "x/y"])
    assert len(set(everything.values())) == len(everything)  # also without a spare colour


@pytest.mark.parametrize(
    "heights", [[1.0, 5.0, 9.0], [5.0, 5.0, 5.0], [1.0, 1.1, 1.2, 6.0, 6.1], [4.9, 5.0, 5.1, 5.2]]
)
def test_labels_move_as_little_as_possible(heights):
    """Least squares with a minimum distance is isotonic regression of heights minus steps."""
    steps = 0.7 * np.arange(len(heights))
    expected = isotonic_regression(np.array(heights) - steps).x + steps
    assert spread_labels(heights, 0.7, 0, 10) == pytest.approx(expected)


def test_labels_stay_within_the_panel_and_are_spread_if_they_do_not_fit():
    assert spread_labels([9.8, 9.9, 9.9], 0.5, 0, 10) == pytest.approx([9.0, 9.5, 10.0])
    assert spread_labels([1.0, 1.0, 9.0], 8, 0, 10) == [0, 5, 10]


@pytest.mark.parametrize("name", ["mean", "accumulate/contrast", "WWW/iii@openvino-half"])
def test_the_width_of_a_label_is_enough_for_its_drawn_text_and_little_more(name):
    axes = Figure(figsize=(9, 3), dpi=150).subplots()
    label_curves(axes, [(name, 0.5, 0.5)], line_styles([name]), 3, ".1f")
    (text,) = (text for text in axes.texts if text.get_text())
    drawn = text.get_window_extent().width / 150
    assert drawn <= label_width([(name, 0.5), ("", 0.1)], ".1f") < 1.15 * drawn


@pytest.mark.parametrize(
    ("times", "expected"),
    [
        ([], []),
        ([5.0, 2.0, 3.0], [1, 2]),
        ([1.0, 9.0, 3.0, 4.0], [0, 2, 3]),
        ([2.0, 2.0], [0, 1]),  # equal times do not run backwards
    ],
)
def test_a_line_joins_the_longest_rise(times, expected):
    assert longest_rise(times) == expected
