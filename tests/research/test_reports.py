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


def test_scores_of_learners_are_means_over_seeds_with_their_range():
    records = [("critic", "direct", seed, 100, 200.0, 0.5 + seed / 10) for seed in (0, 1)]
    columns = ["learner", "mode", "seed", "frames", "seconds", "score"]
    (means,) = known_optimum.average_seeds(pd.DataFrame(records, columns=columns)).itertuples()
    assert (means.score, means.lowest, means.highest) == (0.55, 0.5, 0.6)


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
