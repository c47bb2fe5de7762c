"""The known-optimum report: scores over seeds, and the figure."""

from __future__ import annotations

import pandas as pd
import pytest
from PIL import Image

from reports.known_optimum import curves, draw, table


@pytest.fixture
def rows() -> pd.DataFrame:
    """Two seeds of one learner in both modes, two points each."""
    return pd.DataFrame(
        [
            ("critic", mode, seed, frames, 2.0 * frames, score + seed / 10)
            for mode in ("direct", "filter")
            for seed in (0, 1)
            for frames, score in ((100, 0.5), (200, 0.4))
        ],
        columns=["learner", "mode", "seed", "frames", "seconds", "score"],
    )


def test_the_table_tells_the_last_score_with_its_range_and_the_best(rows):
    line = table(rows).splitlines()[-1]
    assert line == (
        "| critic | 0.45 (0.40 to 0.50) | 0.55 | 0.45 (0.40 to 0.50) | 0.55 | 200 | 400 | 2 |"
    )


def test_curves_are_means_over_seeds(rows):
    first = curves(rows).iloc[0]
    assert (first["least"], first["greatest"]) == (0.5, 0.6)
    assert first["score"] == pytest.approx(0.55)


def test_the_figure_has_ink(rows, tmp_path):
    draw(rows, tmp_path / "figure.png")
    image = Image.open(tmp_path / "figure.png").convert("L")
    assert image.getextrema() == (pytest.approx(0, abs=60), 255)
