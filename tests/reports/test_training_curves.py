"""Curves of validation, from the model cards that ship."""

from __future__ import annotations

from pathlib import Path

from reports.training_curves import draw_trainings, read_cards, shipped_cards
from rlbench.weights import read_card


def test_each_trained_card_that_ships_is_a_curve() -> None:
    cards = [read_card(path.with_suffix(".safetensors")) for path in shipped_cards()]
    trained = {card.name: card.validation_history for card in cards if card.validation_history}
    curves = {t.name: tuple(zip(t.crops, t.psnr, strict=True)) for t in read_cards(shipped_cards())}
    assert curves == {name: tuple(map(tuple, history)) for name, history in trained.items()}
    assert len(curves) > 20


def test_published_weights_have_no_curve(tmp_path: Path) -> None:
    card = tmp_path / "intel.toml"
    card.write_text('name = "intel"\norigin = "published"\n')
    assert read_cards([card]) == []


def test_names_stand_in_the_order_of_the_curves_ends() -> None:
    figure = draw_trainings(read_cards(shipped_cards()))
    for axes in figure.axes:
        names = [(text.get_position()[1], float(text.get_text().split()[1])) for text in axes.texts]
        assert names == sorted(names)
