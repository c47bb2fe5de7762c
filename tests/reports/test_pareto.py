"""Pareto plot, paper's figures and frame times: what is drawn is what was measured."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np
import pandas as pd
import pytest
from matplotlib.collections import LineCollection
from matplotlib.colors import same_color

from reports import frame_time, pareto, published_pareto
from reports.analysis.rows import ReportError
from reports.analysis.scores import FRAME_PARTS, Scores
from reports.frame_time import PARTS, draw_frame_bars
from reports.layout import style
from reports.pareto import MAX_PANELS, OVERALL, PALE, WINDOW_DB, Labels, draw_pareto
from reports.published import published
from rlbench.benchmark.results import MissingRowsError, to_dataframe
from tests.reports.conftest import METHODS, OFFSET, SAMPLE_MS, SCENES, as_published, renamed, rows
from tests.reports.formula_results import doubt

LABELS = Labels("PSNR", "higher", "profile paper-2080ti")
MEAN_MS = sum(SAMPLE_MS.values()) / 4
TWO_DEVICES = "two devices: inference of a CPU, samples of a GPU"


def points_of(table):
    return pareto.plotted_points(Scores(to_dataframe(table)))


@pytest.fixture(scope="module")
def figure(results):
    return draw_pareto(pareto.plotted_points(Scores(results)), LABELS)


def drawn(figure, panel, method):
    """Times and values of a curve as matplotlib holds them."""
    axes = next(a for a in figure.axes if a.get_title(loc="left") == panel)
    color = style.line_styles(METHODS)[method].color
    line = next(a for a in axes.lines if a.get_color() == color and a.get_linestyle() == "-")
    return line.get_xdata(), line.get_ydata()


def test_the_curve_of_a_scene_has_the_measured_points(figure):
    times, values = drawn(figure, "hall", "ntas")
    start, slope, plan, denoise = METHODS["ntas"]
    budgets = [0.5, 1.0, 2.0, 4.0, 8.0]
    assert list(times) == pytest.approx([plan + denoise + 0.99 * s * 34.5 for s in budgets])
    assert list(values) == pytest.approx([start + slope * (i - 1) - 4.0 for i in range(5)])
    times, values = drawn(figure, OVERALL, "ours")
    assert (times[1], values[1]) == pytest.approx((16.5 + 0.99 * MEAN_MS, 29.9 + OFFSET))


def test_there_is_a_panel_for_each_scene_of_few(figure):
    assert [a.get_title(loc="left") for a in figure.axes] == [OVERALL, *sorted(SCENES)]
    every = points_of(rows())
    many = [every.assign(scene=f"generated-{number}") for number in range(MAX_PANELS + 1)]
    axes = draw_pareto(pd.concat([every[every["scene"] == OVERALL], *many]), LABELS).axes
    assert [a.get_title(loc="left") for a in axes] == [OVERALL]


def test_methods_below_the_window_are_named_and_do_not_stretch_the_axis(results):
    short = results[results["method"] != "ours/latent-small"]  # long names leave a narrow panel
    every = pareto.plotted_points(Scores(short))
    far = every.iloc[[0]].assign(method="mean", value=every["value"].max() - 50, frame_ms=1e6)
    far = far.assign(scene=OVERALL, front=False)
    axes = draw_pareto(pd.concat([every, far]), LABELS).axes[0]
    assert axes.get_xlim()[1] < 1e4
    axes = draw_pareto(every, LABELS).axes[0]
    top = 29.9 + 3 * 1.15 + OFFSET
    assert axes.get_ylim()[0] == pytest.approx(top - WINDOW_DB * 1.07)
    assert "below the axis: mean from 13.0" in [text.get_text() for text in axes.texts]


def test_a_line_skips_a_point_whose_time_runs_backwards():
    points = points_of(rows(["ours"]))
    points.loc[points["target_spp"] == 2, "frame_ms"] = 1.0
    line = next(a for a in draw_pareto(points, LABELS).axes[0].lines if a.get_linestyle() == "-")
    assert len(line.get_xdata()) == 4
    assert (np.diff(line.get_xdata()) > 0).all()


@pytest.mark.parametrize(("metric", "sign"), [("psnr", 1), ("relmse", -1)])
def test_the_front_has_the_best_method_for_each_time(results, metric, sign):
    points = pareto.plotted_points(Scores(results, metric))
    front = points[points["front"] & (points["scene"] == OVERALL)].sort_values("frame_ms")
    assert front["method"].tolist()[:2] == ["mean", "ours/latent-small"]
    assert front["method"].iloc[-1] == "ours"
    assert (sign * front["value"].diff().dropna() > 0).all()


@pytest.mark.parametrize(("direction", "expected"), [("higher", [0, 2, 3]), ("lower", [0, 1])])
def test_the_front_has_the_points_that_no_other_dominates(direction, expected):
    times, values = pd.Series([1.0, 2.0, 3.0, 4.0, 4.0]), pd.Series([5.0, 4.0, 6.0, 9.0, 7.0])
    assert pareto.pareto_front(times, values, direction) == expected


@pytest.mark.parametrize(("direction", "edge"), [("higher", 0), ("lower", 1)])
def test_the_area_that_a_single_point_dominates_is_shaded(direction, edge):
    point = points_of(rows(["ours"], scene="city", target_spp=1))
    axes = draw_pareto(point, replace(LABELS, direction=direction)).axes[0]
    heights = axes.collections[0].get_paths()[0].vertices[:, 1]
    assert {round(h, 6) for h in heights} == {29.9, round(axes.get_ylim()[edge], 6)}


def test_the_caption_names_device_cost_and_what_is_left_out():
    lacks = {("oidn", "hall", "sampling_ms"), ("mean", "city", "psnr")}
    table = rows(["ours", "oidn", "mean"])
    table = [r for r in table if (r.method, r.scene, r.metric) not in lacks]
    caption = pareto.figure_labels(Scores(to_dataframe(table), device="x")).caption
    assert "Without a time on every scene: oidn" in caption
    assert "Not on every scene and frame: mean." in caption
    assert "denoise on x" in caption
    assert "profile paper-2080ti" in caption


def test_results_that_have_no_panel_are_refused(tmp_path):
    apart = [
        replace(row, method=f"mine-{index}", scene=f"{row.scene}{index}", clip=f"c{index}")
        for index in range(3)
        for row in rows(["ours"])
    ]
    with pytest.raises(ReportError, match="fewer scenes"):
        pareto.write(to_dataframe(apart), tmp_path)
    with pytest.raises(MissingRowsError, match="no method has all of psnr, plan_ms"):
        points_of([r for r in rows(["ours"]) if r.unit != "ms"])


def busy():
    """Results in which the times of ours in the hall are uncertain, so that its mean is too."""
    times = to_dataframe(rows(("ours", "ours/latent-small", "oidn")))
    return doubt(times, "ours", scene="hall", high=60)


def test_an_uncertain_point_is_pale_with_a_bar_over_its_interval():
    scores = Scores(busy())
    points = pareto.plotted_points(scores)
    doubted = points[points["uncertain"]]
    places = set(doubted[["method", "scene"]].itertuples(index=False, name=None))
    assert places == {("ours", "hall"), ("ours", OVERALL)}
    assert points.loc[points["scene"] == "hall", "front"].any()
    figure = draw_pareto(points, pareto.figure_labels(scores))
    for axes in figure.axes:
        pale = [c for c in axes.collections if c.get_alpha() == PALE]
        bars = [c for c in pale if isinstance(c, LineCollection)]
        count = sum(len(c.get_offsets()) for c in pale if c not in bars)
        assert sum(len(bar.get_segments()) for bar in bars) == count
        assert count == (5 if axes.get_title(loc="left") in ("hall", OVERALL) else 0)


@pytest.mark.parametrize(
    ("methods", "end"), [(("ours", "oidn"), ""), (("ours",), " (ours)"), ((), None)]
)
def test_the_title_names_device_and_size_or_which_frame_times_are_of_two_devices(methods, end):
    frames = [
        replace(row, metric="frame_ms", note=TWO_DEVICES if row.method in methods else "")
        for row in rows(["ours", "oidn"], metric="plan_ms")
    ]
    table = to_dataframe(rows(["ours", "oidn"]) + frames).assign(size="640x360")
    labels = pareto.figure_labels(Scores(table, device="NVIDIA RTX 2080 Ti"))
    title = "NVIDIA RTX 2080 Ti, 640x360" if end is None else TWO_DEVICES.capitalize() + end
    assert labels.heading.lower() == title.lower()


@pytest.fixture(scope="module")
def paper(published_results):
    """How to draw the paper's figures, by axis."""
    figures = published_pareto._figures(Scores(published_results, device="a GPU"))
    return {name.strip("-"): draw() for name, (draw, _) in figures.items() if draw}


def hollow_markers(axes, method):
    """Coordinates of the hollow markers of a method in the drawn figure."""
    line_style = style.line_styles([p.row for p in published().table])[method]
    return next(
        line.get_xydata()
        for line in axes.lines
        if line.get_marker() == line_style.marker
        and same_color(line.get_color(), line_style.color)
        and same_color(line.get_markerfacecolor(), "white")
        and line.get_transform() == axes.transData
    )


@pytest.mark.parametrize(
    ("axis", "method", "expected"),
    [
        ("spp", "ntas", [(4, 27.7)]),
        ("spp", "ours/latent", [(2, 28.2), (4, 28.7)]),
        ("time", "ntas", [(17.4 + 4 * 26.3, 27.7)]),
        ("time", "mean", [(4 * 26.3, 17.0)]),
    ],
)
def test_the_right_panel_has_the_published_points_hollow(paper, axis, method, expected):
    found = hollow_markers(paper[axis].axes[1], method)
    assert found == pytest.approx(np.array(expected))


@pytest.mark.parametrize("panel", [0, 1])
@pytest.mark.parametrize("axis", ["spp", "time"])
def test_no_labels_overlap_or_cross_the_edge_and_both_panels_have_one_scale(paper, axis, panel):
    figure = paper[axis]
    figure.draw_without_rendering()
    texts = [t for t in figure.axes[panel].texts if t.get_text()]
    boxes = [t.get_window_extent() for t in texts if not t.get_text().startswith("below the axis:")]
    assert len(boxes) == (len(METHODS) if panel == 0 else len(published().table))
    assert not any(a.overlaps(b) for a, b in combinations(boxes, 2))
    edge = figure.axes[1].get_window_extent().x0 if panel == 0 else figure.bbox.x1
    assert all(box.x1 < edge for box in boxes)
    heights = [low - high for low, high in (axes.get_ylim() for axes in figure.axes)]
    assert heights[0] == pytest.approx(heights[1])


def test_the_papers_captions_name_device_cost_and_what_is_not_drawn(paper):
    caption = " ".join(paper["time"].texts[-1].get_text().split())
    assert all(text in caption for text in ("a GPU", "profile paper-2080ti", "26.3 ms"))
    table = as_published(rows(["ours"])) + renamed(rows(["ours"]), ours="eaw")
    timeless = Scores(to_dataframe([r for r in table if r.unit != "ms"]))
    draw, _ = published_pareto._figures(timeless)["-time"]
    figure = draw()
    caption = " ".join(figure.texts[-1].get_text().split())
    assert "not in the paper or not on every scene: eaw." in caption
    assert "Without a time: ours/latent." in caption
    assert [t.get_text() for t in figure.axes[0].texts] == ["no times were measured"]


def widths(axes, method):
    """Widths of the parts of one method's bar, from left to right."""
    place = [text.get_text() for text in axes.get_yticklabels()].index(method)
    bars = [b for b in axes.patches if round(b.get_y() + b.get_height() / 2) == place]
    return [bar.get_width() for bar in bars]


def test_frame_time_has_bars_of_the_parts_that_add_up(tmp_path):
    table = [
        replace(r, value=3.0 if r.metric == "gbuffer_ms" else 2.0 * (r.method == "ours"))
        if r.metric in ("gbuffer_ms", "allocate_ms")
        else r
        for r in rows()
    ]
    times = frame_time.frame_times(Scores(to_dataframe(table)))
    assert times[FRAME_PARTS].sum(axis=1).tolist() == pytest.approx(times["frame_ms"].tolist())
    (axes,) = draw_frame_bars(times[times["target_spp"] == 2.0], "caption").axes
    assert widths(axes, "ours") == pytest.approx([3.0, 5.5, 2.0, 1.98 * MEAN_MS, 11.0])
    assert widths(axes, "oidn") == pytest.approx([3.0, 0.0, 0.0, 1.98 * MEAN_MS, 9.0])
    assert list(PARTS) == FRAME_PARTS
    files = frame_time.write(to_dataframe(table), tmp_path)
    assert pd.read_csv(files[-1])["target_spp"].nunique() == 5 > frame_time.MAX_PANELS


def test_frame_time_marks_uncertain_times_and_methods_that_lack_a_budget():
    times = frame_time.frame_times(Scores(busy()))
    times = times[times["target_spp"].isin([1.0, 2.0])]
    lacking = times[(times["method"] != "oidn") | (times["target_spp"] > 1)]
    texts = [text.get_text() for text in draw_frame_bars(lacking, "caption").axes[0].texts]
    assert sum(text.endswith(" %") for text in texts) == 1
    assert texts.count("not measured") == 1
