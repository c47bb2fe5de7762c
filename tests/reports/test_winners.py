"""The winner map: its cells are the winners, its hatching the intervals, its colours the usual."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.colors import to_rgb

from reports import winners
from reports.analysis.curves import curves_of
from reports.analysis.scores import Scores
from reports.layout import style
from reports.winners import draw_winner_map, method_colours
from tests.reports.formula_results import THREE, Formula, table


@pytest.fixture(scope="module")
def three():
    return winners.map_winners(curves_of(Scores(table(THREE))))


def test_each_cell_has_the_best_method_that_fits(three):
    """Brute force over a dense grid of budgets, for some of the cells."""
    spp = np.geomspace(1, 4, 4001)
    names = [*three.methods]
    for row in range(0, len(three.sample_ms), 37):
        for column in range(0, len(three.deadline_ms), 41):
            cost, deadline = three.sample_ms[row], three.deadline_ms[column]
            best = {
                name: formula.score(spp[fits][-1])
                for name, formula in THREE.items()
                if (fits := formula.fixed_ms + cost * spp <= deadline).any()
            }
            index = three.winner[row, column]
            if len(ranked := sorted(best.values())[-2:]) == 2 and ranked[1] - ranked[0] < 0.01:
                continue  # the grid is too coarse to tell
            assert (names[index] if index >= 0 else None) == max(best, key=best.get, default=None)


def test_a_cell_is_hatched_where_the_interval_includes_zero():
    methods = {"a": Formula(20, 1, 1.0, 0.6), "b": Formula(20.3, 1, 1.0), "c": Formula(24, 1, 50.0)}
    cells = winners.map_winners(curves_of(Scores(table(methods))))
    names = np.array([*cells.methods, ""])
    second = names[cells.runner_up]
    is_b = names[cells.winner] == "b"
    assert cells.is_open[is_b & (second == "a")].all()
    is_c = (names[cells.winner] == "c") & (second == "b")
    assert is_c.any()
    assert not cells.is_open[is_c].any()


def test_raw_samples_win_no_cell():
    rows = table({"mean": Formula(40, 1, 0.0), **THREE})
    figures = winners._figures(Scores(rows))
    cells = figures[""][1]
    assert set(cells["method"]) == set(THREE)


def test_a_longer_deadline_changes_nothing_beyond_the_dotted_line(three):
    inside = three.is_exhausted
    assert inside.any()
    assert (np.diff(inside.astype(int), axis=1) >= 0).all()
    assert (three.spp[inside] == 4).all()
    assert not inside[(three.winner != three.winner[:, -1:])].any()


def test_colours_are_those_of_the_pareto_plot():
    methods = ["ours", "ours/latent-small", "ntas", "mine"]
    colours = method_colours(methods, methods)
    styles = style.line_styles(methods)
    for name in ("ours", "ntas", "mine"):
        assert colours[name] == pytest.approx(to_rgb(styles[name].color))
    assert sum(colours["ours/latent-small"]) > sum(colours["ours"])  # a lighter one
    assert len(set(colours.values())) == len(methods)


def test_small_regions_share_one_colour(three):
    """Of twelve winners, eight have a name, and of three the one with 1 % of the map has none."""
    for areas, named in (([8.0] * 12, 8), ([60, 39, 1], 2)):
        edges = np.cumsum(areas) / sum(areas) * three.winner.size
        winner = np.searchsorted(edges, np.arange(three.winner.size), side="right")
        methods = tuple(f"ours/A{index}" for index in range(len(areas)))
        shown = replace(three, methods=methods, winner=winner.reshape(three.winner.shape))
        key = [text.get_text() for text in draw_winner_map(shown, "", 2.0).legends[0].get_texts()]
        assert len(set(key) & set(methods)) == named
        assert f"{len(areas) - named} others" in key
