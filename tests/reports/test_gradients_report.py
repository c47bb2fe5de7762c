"""The gradient report: its figures, its tables, and the committed results."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
import pytest
from PIL import Image

from reports.gradients import (
    LINE_STYLES,
    UNDRAWN,
    draw_gradients,
    draw_ratios,
    gradient_table,
    main,
    ratio_table,
)

DOCS = Path(__file__).parents[2] / "docs"
GRADIENTS, RATIOS = (DOCS / "results" / name for name in ("gradients.csv", "importance_ratio.csv"))


@pytest.fixture
def gradients() -> pd.DataFrame:
    """Two estimators with two denoisers at three budgets; one direction is unknown."""
    columns = ["estimator", "denoiser", "spp", "has_scale", "scale", "scale_margin", "cosine"]
    rows = [
        (name, denoiser, spp, name == "surrogate", spp / 2, 0.4, cosine)
        for name in ("surrogate", "reinforce")
        for denoiser in ("no filter", "count-weighted filter")
        for spp, cosine in ((0.5, None), (4.0, 0.9), (64.0, 0.95))
    ]
    return pd.DataFrame(rows, columns=columns).assign(cosine_margin=0.05, frames=1234.5)


@pytest.fixture
def ratios() -> pd.DataFrame:
    rows = [
        (ratio, step, side, side / 64)
        for ratio in ("joint", "pixel")
        for step in ("mean + 0.001", "Adam 0.001")
        for side in (8, 16)
    ]
    return pd.DataFrame(rows, columns=["ratio", "step", "side", "clipped"])


def test_unknown_directions_and_lengths_are_question_marks(gradients):
    surrogate, reinforce = gradient_table(gradients).splitlines()[2:]
    assert surrogate == (
        "| surrogate | ? / 0.90 / 0.95 | ? / 0.90 / 0.95 | ? / 2.00 / 32.00 "
        "| >183 / 1,234 / 1,234 | >183 / 1,234 / 1,234 |"
    )
    assert "| any |" in reinforce


def test_the_ratio_table_has_a_line_per_ratio_and_step(ratios):
    assert ratio_table(ratios).splitlines()[2:4] == [
        "| joint, mean + 0.001 | 12% | 25% |",
        "| joint, Adam 0.001 | 12% | 25% |",
    ]


def test_the_figures_are_not_blank(gradients, ratios, tmp_path):
    draw_gradients(gradients, tmp_path / "gradients.png")
    draw_ratios(ratios, tmp_path / "ratios.png")
    for file in tmp_path.iterdir():
        assert Image.open(file).convert("L").getextrema() == (pytest.approx(0, abs=60), 255)


def test_every_estimator_of_the_committed_results_has_a_line_style():
    assert set(pd.read_csv(GRADIENTS)["estimator"]) == {*LINE_STYLES, *UNDRAWN}


@pytest.mark.parametrize(
    ("name", "table", "file"),
    [("gradients", gradient_table, GRADIENTS), ("ratios", ratio_table, RATIOS)],
)
def test_the_tables_in_the_docs_are_those_of_the_committed_results(name, table, file):
    page = (DOCS / "concepts" / "learning-to-sample.md").read_text(encoding="utf-8")
    assert page.split(f"<!-- {name} -->\n")[1].split(f"<!-- /{name} -->")[0] == table(
        pd.read_csv(file)
    )


def test_the_command_writes_both_figures_and_prints_both_tables(
    gradients, ratios, tmp_path, capsys
):
    gradients.to_csv(tmp_path / "gradients.csv", index=False)
    ratios.to_csv(tmp_path / "importance_ratio.csv", index=False)
    main(tmp_path)
    assert {file.name for file in tmp_path.glob("*.png")} == {
        "gradients.png",
        "importance_ratio.png",
    }
    assert capsys.readouterr().out == gradient_table(gradients) + "\n" + ratio_table(ratios)
