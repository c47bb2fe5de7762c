"""The known-optimum report: scores over seeds, the figure, and the committed table."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
import pytest
from PIL import Image

from reports.known_optimum import (
    LINE_STYLES,
    average_seeds,
    draw_figure,
    main,
    markdown_table,
    read_rows,
)

DOCS = Path(__file__).parents[2] / "docs"
CSV = DOCS / "results" / "known_optimum.csv"


@pytest.fixture
def rows() -> pd.DataFrame:
    """Two seeds of one learner in both modes, two evaluations each."""
    return pd.DataFrame(
        [
            ("critic", mode, seed, frames, 2.0 * frames, score + seed / 10)
            for mode in ("direct", "filter")
            for seed in (0, 1)
            for frames, score in ((100, 0.5), (200, 0.4))
        ],
        columns=["learner", "mode", "seed", "frames", "seconds", "score"],
    )


def test_the_table_has_the_last_score_with_its_range_and_the_best(rows):
    line = markdown_table(rows).splitlines()[-1]
    assert line == (
        "| critic | 0.45 (0.40 to 0.50) | 0.55 | 0.45 (0.40 to 0.50) | 0.55 | 200 | 400 | 2 |"
    )


def test_curves_are_means_over_seeds(rows):
    first = average_seeds(rows).iloc[0]
    assert (first["lowest"], first["highest"]) == (0.5, 0.6)
    assert first["score"] == pytest.approx(0.55)


def test_the_figure_is_not_blank(rows, tmp_path):
    draw_figure(rows, tmp_path / "figure.png")
    image = Image.open(tmp_path / "figure.png").convert("L")
    assert image.getextrema() == (pytest.approx(0, abs=60), 255)


def test_every_learner_of_the_committed_results_has_a_line_style():
    assert set(read_rows(CSV)["learner"]) == set(LINE_STYLES)


def test_the_table_in_the_docs_is_that_of_the_committed_results():
    page = (DOCS / "concepts" / "learning-to-sample.md").read_text(encoding="utf-8")
    table = page.split("<!-- table -->\n")[1].split("<!-- /table -->")[0]
    assert table == markdown_table(read_rows(CSV))


def test_the_command_writes_the_figure_and_prints_the_table(rows, tmp_path, capsys):
    rows.to_csv(tmp_path / "known_optimum.csv", index=False)
    main(tmp_path)
    assert (tmp_path / "known_optimum.png").is_file()
    assert capsys.readouterr().out == markdown_table(rows)
