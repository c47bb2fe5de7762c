"""Commands that draw what experiments and model cards recorded."""

from __future__ import annotations

import pandas as pd
import pytest

from research.reports import gradients, known_optimum, training_curves
from rlbench.weights import read_card
from tests.reports.test_tools import DOCS, RESULTS, has_ink

SHIPPED = {  # a mark in the page -> a table of the committed results
    "gradients": lambda: gradients.gradient_table(pd.read_csv(RESULTS / "gradients.csv")),
    "ratios": lambda: gradients.ratio_table(pd.read_csv(RESULTS / "importance_ratio.csv")),
    "table": lambda: known_optimum.markdown_table(pd.read_csv(RESULTS / "known_optimum.csv")),
}


@pytest.mark.parametrize("name", SHIPPED)
def test_the_tables_in_the_docs_are_those_of_the_committed_results(name):
    page = (DOCS / "concepts" / "learning-to-sample.md").read_text(encoding="utf-8")
    shown = page.split(f"<!-- {name} -->\n")[1].split(f"<!-- /{name} -->")[0]
    assert shown == SHIPPED[name]()


def test_every_learner_and_estimator_of_the_committed_results_has_a_line_style():
    learners = pd.read_csv(RESULTS / "known_optimum.csv")["learner"]
    assert set(learners) == set(known_optimum.LINE_STYLES)
    estimators = pd.read_csv(RESULTS / "gradients.csv")["estimator"]
    assert set(estimators) == {*gradients.LINE_STYLES, *gradients.UNDRAWN}


@pytest.mark.parametrize(
    ("module", "tables", "figures"),
    [
        (gradients, ("gradients", "importance_ratio"), ("gradients", "importance_ratio")),
        (known_optimum, ("known_optimum",), ("known_optimum",)),
        (training_curves, (), ("training",)),
    ],
)
def test_a_command_draws_the_committed_tables(module, tables, figures, tmp_path, capsys):
    for name in tables:
        (tmp_path / f"{name}.csv").write_bytes((RESULTS / f"{name}.csv").read_bytes())
    module.main(tmp_path)
    assert {file.stem for file in tmp_path.glob("*.png")} == set(figures)
    assert all(has_ink(file) for file in tmp_path.glob("*.png"))
    assert ("| --- |" in capsys.readouterr().out) == bool(tables)


def test_unknown_directions_and_lengths_are_question_marks():
    """Two estimators with two denoisers at three budgets; one direction is unknown."""
    columns = ["estimator", "denoiser", "spp", "has_scale", "scale", "scale_margin", "cosine"]
    records = [
        (name, denoiser, spp, name == "surrogate", spp / 2, 0.4, cosine)
        for name in ("surrogate", "reinforce")
        for denoiser in ("no filter", "count-weighted filter")
        for spp, cosine in ((0.5, None), (4.0, 0.9), (64.0, 0.95))
    ]
    table = pd.DataFrame(records, columns=columns).assign(cosine_margin=0.05, frames=1234.5)
    surrogate, reinforce = gradients.gradient_table(table).splitlines()[2:]
    assert surrogate == (
        "| surrogate | ? / 0.90 / 0.95 | ? / 0.90 / 0.95 | ? / 2.00 / 32.00 "
        "| >183 / 1,234 / 1,234 | >183 / 1,234 / 1,234 |"
    )
    assert "| any |" in reinforce


def test_scores_of_learners_are_means_over_seeds_with_their_range():
    records = [
        ("critic", mode, seed, frames, 2.0 * frames, score + seed / 10)
        for mode in ("direct", "filter")
        for seed in (0, 1)
        for frames, score in ((100, 0.5), (200, 0.4))
    ]
    columns = ["learner", "mode", "seed", "frames", "seconds", "score"]
    table = pd.DataFrame(records, columns=columns)
    both = "0.45 (0.40 to 0.50) | 0.55"
    line = known_optimum.markdown_table(table).splitlines()[-1]
    assert line == f"| critic | {both} | {both} | 200 | 400 | 2 |"
    first = known_optimum.average_seeds(table).iloc[0]
    assert (first["lowest"], first["highest"]) == (0.5, 0.6)


def test_each_trained_card_that_ships_is_a_curve_named_at_its_end():
    cards = [read_card(p.with_suffix(".safetensors")) for p in training_curves.shipped_cards()]
    trained = {card.name: card.validation_history for card in cards if card.validation_history}
    trainings = training_curves.read_cards(training_curves.shipped_cards())
    curves = {t.name: tuple(zip(t.crops, t.psnr, strict=True)) for t in trainings}
    assert curves == {name: tuple(map(tuple, history)) for name, history in trained.items()}
    assert len(curves) > 20
    for axes in training_curves.draw_trainings(trainings).axes:
        ends = [(text.get_position()[1], float(text.get_text().split()[1])) for text in axes.texts]
        assert ends == sorted(ends)
