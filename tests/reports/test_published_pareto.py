"""The paper's figures: both panels have their points, and no labels overlap."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np
import pandas as pd
import pytest
from matplotlib.colors import same_color

from reports import published_pareto
from reports.analysis.scores import Scores
from reports.layout import paired_panels, style
from reports.published import published
from rlbench.benchmark.results import MissingRowsError, to_dataframe
from tests.reports.conftest import METHODS, SAMPLE_MS, SCENES, as_published, rows

OFFSET = sum(SCENES.values()) / 4


@pytest.fixture(scope="module")
def figures(published_results):
    return published_pareto.draw_figures(Scores(published_results, device="a GPU"))


@pytest.fixture(scope="module")
def files(published_results, tmp_path_factory):
    return published_pareto.write(published_results, tmp_path_factory.mktemp("paper"))


def points(axes, method, face):
    """Coordinates of the markers of a method, filled or hollow, in the drawn figure."""
    line_style = style.line_styles([p.row for p in published().table])[method]
    face_color = "white" if face == "hollow" else line_style.color
    return next(
        line.get_xydata()
        for line in axes.lines
        if line.get_marker() == line_style.marker
        and same_color(line.get_color(), line_style.color)
        and same_color(line.get_markerfacecolor(), face_color)
        and line.get_transform() == axes.transData
    )


def test_two_figures_and_a_csv_of_their_points_are_written(files):
    kinds = ("png", "pdf", "svg")
    images = [f"paper-{axis}.{kind}" for axis in ("spp", "time") for kind in kinds]
    assert [file.name for file in files] == [*images, "paper-pareto.csv"]
    assert all(file.stat().st_size > 1000 for file in files)


@pytest.mark.parametrize("method", ["ours/latent", "oidn"])
def test_the_left_panel_has_the_measured_points_filled(figures, method):
    start, slope, plan, denoise = METHODS["ours" if method == "ours/latent" else method]
    budgets = np.array([0.5, 1, 2, 4, 8])
    measured = points(figures["time"].axes[0], method, "filled")
    sampling = 0.99 * budgets * sum(SAMPLE_MS.values()) / 4
    assert measured[:, 0] == pytest.approx(plan + denoise + sampling)
    assert measured[:, 1] == pytest.approx(start + slope * np.log2(budgets) + OFFSET)


@pytest.mark.parametrize(
    ("axis", "method", "expected"),
    [
        ("spp", "ntas", [(4, 27.7)]),
        ("spp", "ours/latent", [(2, 28.2), (4, 28.7)]),
        ("time", "ntas", [(17.4 + 4 * 26.3, 27.7)]),
        ("time", "mean", [(4 * 26.3, 17.0)]),
    ],
)
def test_the_right_panel_has_the_published_points_hollow(figures, axis, method, expected):
    printed = points(figures[axis].axes[1], method, "hollow")
    assert printed == pytest.approx(np.array(expected))


@pytest.mark.parametrize("axis", paired_panels.AXES)
def test_both_panels_have_one_scale(figures, axis):
    heights = [low - high for low, high in (axes.get_ylim() for axes in figures[axis].axes)]
    assert heights[0] == pytest.approx(heights[1])


@pytest.mark.parametrize("panel", [0, 1])
@pytest.mark.parametrize("axis", paired_panels.AXES)
def test_no_labels_overlap_or_cross_the_edge(figures, axis, panel):
    figure = figures[axis]
    figure.draw_without_rendering()
    texts = [t for t in figure.axes[panel].texts if t.get_text()]
    boxes = [t.get_window_extent() for t in texts if not t.get_text().startswith("below the axis:")]
    assert len(boxes) == (len(METHODS) if panel == 0 else len(published().table))
    assert not any(a.overlaps(b) for a, b in combinations(boxes, 2))
    edge = figure.axes[1].get_window_extent().x0 if panel == 0 else figure.bbox.x1
    assert all(box.x1 < edge for box in boxes)


def test_points_below_the_panel_are_named_and_do_not_stretch_it(published_results):
    is_mean = published_results["method"] == "mean"
    low = published_results[is_mean].copy()
    low.loc[low["metric"] == "psnr", "value"] = 1.0
    low.loc[low["metric"] == "frame_ms", "value"] = 0.01
    scores = Scores(pd.concat([published_results[~is_mean], low]))
    left = published_pareto.draw_figures(scores)["time"].axes[0]
    assert "below the axis: mean from 1.0" in [text.get_text() for text in left.texts]
    assert left.get_xlim()[0] > 0.1


def caption(figure):
    return " ".join(figure.texts[-1].get_text().split())


def test_methods_that_the_paper_lacks_are_named_in_the_caption():
    other = [replace(r, method="eaw") for r in rows(["ours"])]
    scores = Scores(to_dataframe([*as_published(rows(["ours"])), *other]))
    figures = published_pareto.draw_figures(scores)
    assert "not in the paper or not on every scene: eaw." in caption(figures["spp"])


@pytest.mark.parametrize("text", ["a GPU", "profile paper-2080ti", "26.3 ms"])
def test_the_caption_of_times_names_device_and_cost(figures, text):
    assert text in caption(figures["time"])


def test_without_times_the_budgets_are_still_drawn():
    table = as_published(rows(["ours", "mean"]))
    timeless = to_dataframe([r for r in table if r.unit != "ms"])
    figures = published_pareto.draw_figures(Scores(timeless))
    assert [t.get_text() for t in figures["time"].axes[0].texts] == ["no times were measured"]
    assert "Without a time: mean, ours/latent." in caption(figures["time"])
    assert len(points(figures["spp"].axes[0], "ours/latent", "filled")) == 5


def test_the_csv_has_measured_and_published_points(files):
    points = pd.read_csv(files[-1])
    assert points.groupby("source").size().to_dict() == {"here": 25, "paper": 16}


@pytest.mark.slow  # twelve files
def test_each_device_has_figures_of_its_own(tmp_path):
    mixed = to_dataframe(as_published(rows(["ours"])) + rows(["ntas"], device="H100"))
    names = {file.name for file in published_pareto.write(mixed, tmp_path) if file.suffix == ".png"}
    assert {"paper-spp-h100.png", "paper-time-nvidia-rtx-2080-ti.png"} < names


def test_results_without_a_method_of_the_paper_are_refused(tmp_path):
    other = to_dataframe([replace(r, method="mine") for r in rows(["ours"])])
    with pytest.raises(MissingRowsError, match="methods in the results: mine"):
        published_pareto.write(other, tmp_path)
