"""Labels beside curves: they move as little as possible and stay within the panel."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.figure import Figure
from scipy.optimize import isotonic_regression

from reports.layout.curve_labels import label_curves, label_width, spread_labels
from reports.layout.style import line_styles


@pytest.mark.parametrize(
    "heights", [[1.0, 5.0, 9.0], [5.0, 5.0, 5.0], [1.0, 1.1, 1.2, 6.0, 6.1], [4.9, 5.0, 5.1, 5.2]]
)
def test_labels_move_as_little_as_possible(heights):
    """Least squares with a minimum distance is isotonic regression of heights minus steps."""
    step = 0.7
    steps = step * np.arange(len(heights))
    expected = isotonic_regression(np.array(heights) - steps).x + steps
    assert spread_labels(heights, step, 0, 10) == pytest.approx(expected)


def test_labels_stay_within_the_panel():
    heights = spread_labels([9.8, 9.9, 9.9], 0.5, 0, 10)
    assert heights == pytest.approx([9.0, 9.5, 10.0])


def test_labels_that_do_not_fit_are_evenly_spread():
    assert spread_labels([1.0, 1.0, 9.0], 8, 0, 10) == [0, 5, 10]


@pytest.mark.parametrize("dpi", [100, 150, 300])
@pytest.mark.parametrize("name", ["mean", "accumulate/contrast", "WWW/iii@openvino-bf16"])
def test_the_width_of_a_label_is_enough_for_its_drawn_text_and_little_more(name, dpi):
    axes = Figure(figsize=(9, 3), dpi=dpi).subplots()
    label_curves(axes, [(name, 0.5, 0.5)], line_styles([name]), 3, ".1f")
    (text,) = (text for text in axes.texts if text.get_text())
    drawn = text.get_window_extent().width / dpi
    assert drawn <= label_width([(name, 0.5), ("", 0.1)], ".1f") < 1.15 * drawn
