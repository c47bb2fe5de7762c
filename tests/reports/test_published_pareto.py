"""The paper's figures: both panels hold their points, and no name lies over another."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np
import pandas as pd
import pytest
from conftest import METHODS, SAMPLE_MS, SCENES, rows
from matplotlib.colors import same_color
from scipy.optimize import isotonic_regression

from reports import published_pareto
from reports.layout import paired_panels
from reports.published import published
from rlbench.benchmark.results import MissingRowsError, to_dataframe

OFFSET = sum(SCENES.values()) / 4


@pytest.fixture(scope="module")
def drawn(results):
    return published_pareto.figures(results, "a GPU")


@pytest.fixture(scope="module")
def files(results, tmp_path_factory):
    return published_pareto.write(results, tmp_path_factory.mktemp("paper"))


def points(axes, method, face):
    """Coordinates of the markers of a method, filled or white, as matplotlib holds them."""
    look = paired_panels.style.line_styles([s.row for s in published().table])[method]
    wanted = "white" if face == "hollow" else look.color
    return next(
        line.get_xydata()
        for line in axes.lines
        if line.get_marker() == look.marker
        and same_color(line.get_color(), look.color)
        and same_color(line.get_markerfacecolor(), wanted)
        and line.get_transform() == axes.transData
    )


def test_two_figures_and_what_they_show_are_written(files):
    kinds = ("png", "pdf", "svg")
    wanted = [f"paper-{axis}.{kind}" for axis in ("spp", "time") for kind in kinds]
    assert [file.name for file in files] == [*wanted, "paper-pareto.csv"]
    assert all(file.stat().st_size > 1000 for file in files)


@pytest.mark.parametrize("method", ["ours", "oidn"])
def test_the_left_panel_has_the_measured_points_filled(drawn, method):
    start, slope, plan, denoise = METHODS[method]
    budgets = np.array([0.5, 1, 2, 4, 8])
    found = points(drawn["time"].axes[0], method, "filled")
    sampling = 0.99 * budgets * sum(SAMPLE_MS.values()) / 4
    assert found[:, 0] == pytest.approx(plan + denoise + sampling)
    assert found[:, 1] == pytest.approx(start + slope * np.log2(budgets) + OFFSET)


@pytest.mark.parametrize(
    ("axis", "method", "wanted"),
    [
        ("spp", "ntas", [(4, 27.7)]),
        ("spp", "ours", [(2, 28.2), (4, 28.7)]),
        ("time", "ntas", [(17.4 + 4 * 26.3, 27.7)]),
        ("time", "mean", [(4 * 26.3, 17.0)]),
    ],
)
def test_the_right_panel_has_the_published_points_hollow(drawn, axis, method, wanted):
    found = points(drawn[axis].axes[1], method, "hollow")
    assert found == pytest.approx(np.array(wanted))


@pytest.mark.parametrize("axis", paired_panels.AXES)
def test_both_panels_have_one_scale(drawn, axis):
    heights = [low - high for low, high in (axes.get_ylim() for axes in drawn[axis].axes)]
    assert heights[0] == pytest.approx(heights[1])


@pytest.mark.parametrize("panel", [0, 1])
@pytest.mark.parametrize("axis", paired_panels.AXES)
def test_no_name_lies_over_another_or_beyond_the_edge(drawn, axis, panel):
    figure = drawn[axis]
    figure.draw_without_rendering()
    texts = [t for t in figure.axes[panel].texts if t.get_text()]
    boxes = [t.get_window_extent() for t in texts if not t.get_text().startswith("below:")]
    assert len(boxes) == (len(METHODS) if panel == 0 else len(published().table))
    assert not any(a.overlaps(b) for a, b in combinations(boxes, 2))
    edge = figure.axes[1].get_window_extent().x0 if panel == 0 else figure.bbox.x1
    assert all(box.x1 < edge for box in boxes)


def test_points_below_the_panel_are_named_and_take_no_room_in_it(results):
    low = results[results["method"] == "mean"].copy()
    low.loc[low["metric"] == "psnr", "value"] = 1.0
    low.loc[low["metric"] == "frame_ms", "value"] = 0.01
    others = results[results["method"] != "mean"]
    left = published_pareto.figures(pd.concat([others, low]), "a GPU")["time"].axes[0]
    assert "below: mean from 1.0" in [text.get_text() for text in left.texts]
    assert left.get_xlim()[0] > 0.1


@pytest.mark.parametrize(
    "heights", [[1.0, 5.0, 9.0], [5.0, 5.0, 5.0], [1.0, 1.1, 1.2, 6.0, 6.1], [4.9, 5.0, 5.1, 5.2]]
)
def test_names_move_as_little_as_need_be(heights):
    """Least squares with gaps of at least `step` is isotonic regression of heights less steps."""
    step = 0.7
    stairs = step * np.arange(len(heights))
    wanted = isotonic_regression(np.array(heights) - stairs).x + stairs
    assert paired_panels.spread_labels(heights, step, 0, 10) == pytest.approx(wanted)


def test_names_stay_within_the_panel():
    found = paired_panels.spread_labels([9.8, 9.9, 9.9], 0.5, 0, 10)
    assert found == pytest.approx([9.0, 9.5, 10.0])


def test_names_that_do_not_fit_are_evenly_spread():
    assert paired_panels.spread_labels([1.0, 1.0, 9.0], 8, 0, 10) == [0, 5, 10]


def caption(figure):
    return " ".join(figure.texts[-1].get_text().split())


def test_rows_that_the_paper_lacks_are_named_in_the_caption():
    strange = [replace(r, method="eaw") for r in rows(["ours"])]
    figures = published_pareto.figures(to_dataframe([*rows(["ours"]), *strange]), "")
    assert "not in the paper or not on every scene: eaw." in caption(figures["spp"])


@pytest.mark.parametrize("told", ["a GPU", "profile paper-2080ti", "26.3 ms"])
def test_the_time_figure_says_where_it_was_taken_and_whose_cost_it_has(drawn, told):
    assert told in caption(drawn["time"])


def test_without_times_the_budgets_are_still_drawn():
    timeless = to_dataframe([r for r in rows(["ours", "mean"]) if r.unit != "ms"])
    figures = published_pareto.figures(timeless, "")
    assert [t.get_text() for t in figures["time"].axes[0].texts] == ["no times were measured"]
    assert "Without a time: mean, ours." in caption(figures["time"])
    assert len(points(figures["spp"].axes[0], "ours", "filled")) == 5


def test_the_csv_holds_both(files):
    found = pd.read_csv(files[-1])
    assert found.groupby("source").size().to_dict() == {"here": 25, "paper": 16}


@pytest.mark.slow  # twelve files
def test_each_device_has_figures_of_its_own(tmp_path):
    mixed = to_dataframe(rows(["ours"]) + rows(["ntas"], device="H100"))
    names = {file.name for file in published_pareto.write(mixed, tmp_path) if file.suffix == ".png"}
    assert {"paper-spp-h100.png", "paper-time-nvidia-rtx-2080-ti.png"} < names


def test_a_table_without_any_row_of_the_paper_is_refused(tmp_path):
    strange = to_dataframe([replace(r, method="mine") for r in rows(["ours"])])
    with pytest.raises(MissingRowsError, match="results are of: mine"):
        published_pareto.write(strange, tmp_path)
