"""The Pareto plot: the drawn points are the measured ones, and every file is written."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace

import pandas as pd
import pytest
from matplotlib.image import imread

from reports import pareto
from reports.analysis.rows import ReportError
from reports.analysis.scores import Scores
from reports.layout import style
from reports.pareto import MAX_PANELS, OVERALL, WINDOW_DB, Labels, draw_pareto
from rlbench.benchmark.results import to_dataframe
from tests.reports.conftest import METHODS, SAMPLE_MS, SCENES, rows

LABELS = Labels("PSNR", "higher", "profile paper-2080ti")


@pytest.fixture(scope="module")
def figure(results):
    return draw_pareto(pareto.plotted_points(Scores(results)), LABELS)


@pytest.fixture(scope="module")
def files(results, tmp_path_factory):
    return pareto.write(results, tmp_path_factory.mktemp("pareto"))


def drawn(figure, panel, method):
    """Times and values of a curve as matplotlib holds them."""
    axes = next(a for a in figure.axes if a.get_title(loc="left") == panel)
    color = style.line_styles(METHODS)[method].color
    line = next(a for a in axes.lines if a.get_color() == color and a.get_linestyle() == "-")
    return line.get_xdata(), line.get_ydata()


def test_three_images_and_a_csv_are_written(files):
    assert [file.name for file in files] == [
        "pareto.png", "pareto.pdf", "pareto.svg", "pareto.csv",
    ]  # fmt: skip
    assert all(file.stat().st_size > 1000 for file in files)


def test_the_png_is_not_blank(files):
    image = imread(files[0])
    assert image.shape[1] == 1950  # 13 inches at 150 dpi
    assert 0.02 < (image[..., :3].min(2) < 0.9).mean() < 0.5


@pytest.mark.parametrize("method", ["ours", "ntas", "oidn"])
def test_the_curve_of_a_scene_has_the_measured_points(figure, method):
    times, values = drawn(figure, "hall", method)
    start, slope, plan, denoise = METHODS[method]
    budgets = [0.5, 1.0, 2.0, 4.0, 8.0]
    assert list(times) == pytest.approx([plan + denoise + 0.99 * s * 34.5 for s in budgets])
    assert list(values) == pytest.approx([start + slope * (i - 1) - 4.0 for i in range(5)])


def test_the_overall_curve_is_the_mean_over_scenes(figure):
    times, values = drawn(figure, OVERALL, "ours")
    assert values[1] == pytest.approx(29.9 + sum(SCENES.values()) / 4)
    assert times[1] == pytest.approx(16.5 + 0.99 * sum(SAMPLE_MS.values()) / 4)


def test_the_csv_has_the_plotted_points(results, files):
    points = pd.read_csv(files[-1])
    pd.testing.assert_frame_equal(points, pareto.plotted_points(Scores(results)))


def test_there_is_a_panel_for_each_scene(figure):
    assert [a.get_title(loc="left") for a in figure.axes] == [OVERALL, *sorted(SCENES)]


def test_a_method_without_a_time_on_every_scene_has_no_mean_and_is_named(tmp_path):
    table = to_dataframe(
        [
            r
            for r in rows(["ours", "oidn"])
            if (r.method, r.scene, r.metric) != ("oidn", "hall", "sample_ms")
        ]
    )
    points = pareto.plotted_points(Scores(table))
    assert set(points[points["scene"] == OVERALL]["method"]) == {"ours"}
    assert set(points[points["scene"] == "city"]["method"]) == {"ours", "oidn"}
    files = pareto.write(table, tmp_path)
    assert (
        "Without a time on every scene: oidn"
        in pareto.figure_labels(Scores(table, device="x")).caption
    )
    assert all(file.exists() for file in files)


def test_a_method_that_lacks_a_frame_is_named():
    table = to_dataframe(
        [r for r in rows() if (r.method, r.clip, r.frame) != ("ours", "city-0", 2)]
    )
    caption = pareto.figure_labels(Scores(table, device="x")).caption
    assert "Not on every scene and frame: ours." in caption


def test_many_scenes_have_one_panel_with_their_mean():
    every = pareto.plotted_points(Scores(to_dataframe(rows())))
    parts = [every.assign(scene=f"generated-{number}") for number in range(MAX_PANELS + 1)]
    axes = draw_pareto(pd.concat([every[every["scene"] == OVERALL], *parts]), LABELS).axes
    assert [a.get_title(loc="left") for a in axes] == [OVERALL]


def test_times_of_hidden_points_do_not_stretch_the_axis(results):
    every = pareto.plotted_points(Scores(results))
    far = every.iloc[[0]].assign(method="mean", value=every["value"].max() - 50, frame_ms=1e6)
    for axes in draw_pareto(
        pd.concat([every, far.assign(scene=OVERALL, front=False)]), LABELS
    ).axes[:1]:
        assert axes.get_xlim()[1] < 1e4


def test_one_scene_is_one_panel():
    one = to_dataframe([r for r in rows() if r.scene == "city"])
    assert [
        a.get_title(loc="left")
        for a in draw_pareto(pareto.plotted_points(Scores(one)), LABELS).axes
    ] == ["city"]


def test_times_that_span_more_than_three_are_logarithmic(figure):
    assert {a.get_xscale() for a in figure.axes} == {"log"}


def test_times_that_span_less_than_three_are_linear():
    near = to_dataframe([r for r in rows(["ours", "ntas"]) if r.target_spp in (1, 2)])
    assert {
        a.get_xscale() for a in draw_pareto(pareto.plotted_points(Scores(near)), LABELS).axes
    } == {"linear"}


def test_methods_below_the_window_are_named(results):
    short = results[results["method"] != "ours/latent-small"]  # long names leave a narrow panel
    axes = draw_pareto(pareto.plotted_points(Scores(short)), LABELS).axes[0]
    top = 29.9 + 3 * 1.15 + sum(SCENES.values()) / 4
    assert axes.get_ylim()[0] == pytest.approx(top - WINDOW_DB * 1.07)
    assert "below the axis: mean from 13.0" in [text.get_text() for text in axes.texts]


def test_names_stand_beside_the_first_panel_in_the_order_of_the_last_values(figure):
    names = [t for t in figure.axes[0].texts if t.get_text().partition(" ")[0] in METHODS]
    names.sort(key=lambda text: -text.get_position()[1])
    expected = ["ours", "ours/latent-small", "ntas", "oidn", "mean"]
    assert [text.get_text().partition(" ")[0] for text in names] == expected
    assert [t.get_text() for t in figure.axes[1].texts] == ["1 below the axis"]


def test_a_line_skips_a_point_whose_time_runs_backwards():
    points = pareto.plotted_points(Scores(to_dataframe(rows(["ours"]))))
    points.loc[points["target_spp"] == 2, "frame_ms"] = 1.0
    line = next(a for a in draw_pareto(points, LABELS).axes[0].lines if a.get_linestyle() == "-")
    assert len(line.get_xdata()) == 4
    assert (pd.Series(line.get_xdata()).diff().dropna() > 0).all()


def test_no_two_titles_of_a_panel_touch(figure):
    figure.draw_without_rendering()
    for axes in figure.axes:
        assert not axes._left_title.get_window_extent().overlaps(
            axes._right_title.get_window_extent()
        )


def test_the_front_has_the_best_method_for_each_time(results):
    points = pareto.plotted_points(Scores(results))
    front = points[points["front"] & (points["scene"] == OVERALL)].sort_values("frame_ms")
    assert front["method"].tolist()[:2] == ["mean", "ours/latent-small"]
    assert (front["value"].diff().dropna() > 0).all()
    assert front["method"].iloc[-1] == "ours"


def test_the_caption_names_device_and_cost_profile(results, tmp_path, monkeypatch):
    monkeypatch.setitem(style.RC, "svg.fonttype", "none")  # letters, not their outlines
    svg = pareto.write(results, tmp_path)[2].read_text()
    for text in ("profile paper-2080ti", "NVIDIA RTX 2080 Ti", "higher is better"):
        assert text in svg


def test_methods_without_a_common_scene_have_no_panel_of_their_mean(tmp_path):
    table = to_dataframe([r for r in rows(["ours"]) if r.scene == "city"])
    other = to_dataframe([r for r in rows(["ntas"]) if r.scene == "hall"])
    pareto.write(pd.concat([table, other]), tmp_path)
    assert set(pd.read_csv(tmp_path / "pareto.csv")["scene"]) == {"city", "hall"}
    assert (tmp_path / "pareto.png").is_file()


def test_many_scenes_without_a_common_method_are_refused(tmp_path):
    parts = [
        replace(row, method=f"mine-{index}", scene=f"{row.scene}{index}", clip=f"c{index}")
        for index in range(3)
        for row in rows(["ours"])
    ]
    with pytest.raises(ReportError, match="12 scenes.*fewer scenes"):
        pareto.write(to_dataframe(parts), tmp_path)


def test_each_device_has_a_plot_of_its_own(tmp_path):
    mixed = to_dataframe(rows(["ours"]) + rows(["ntas"], device="H100"))
    files = {file.name for file in pareto.write(mixed, tmp_path) if file.suffix == ".csv"}
    assert files == {"pareto-h100.csv", "pareto-nvidia-rtx-2080-ti.csv"}
    assert set(pd.read_csv(tmp_path / "pareto-h100.csv")["method"]) == {"ntas"}


def test_results_without_times_are_refused_with_the_missing_metrics(tmp_path):
    timeless = to_dataframe([r for r in rows(["ours"]) if r.unit != "ms"])
    with pytest.raises(
        ReportError, match="no method has all of psnr, plan_ms, denoise_ms and sample_ms"
    ):
        pareto.write(timeless, tmp_path)


def test_equal_results_give_equal_files(results, files, tmp_path):
    again = pareto.write(results, tmp_path)
    assert [f.read_bytes() for f in files] == [f.read_bytes() for f in again]


@pytest.mark.parametrize(("direction", "edge"), [("higher", 0), ("lower", 1)])
def test_the_area_that_a_single_point_dominates_is_shaded(direction, edge):
    point = to_dataframe([r for r in rows(["ours"]) if r.scene == "city" and r.target_spp == 1])
    axes = draw_pareto(
        pareto.plotted_points(Scores(point)), replace(LABELS, direction=direction)
    ).axes[0]
    heights = axes.collections[0].get_paths()[0].vertices[:, 1]
    assert {round(h, 6) for h in heights} == {29.9, round(axes.get_ylim()[edge], 6)}


def test_a_low_error_is_better(results):
    points = pareto.plotted_points(Scores(results, "relmse"))
    front = points[points["front"] & (points["scene"] == "city")].sort_values("frame_ms")
    assert (front["value"].diff().dropna() < 0).all()


def test_reports_do_not_import_torch():
    code = "import sys, reports.pareto, reports.summary; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


@pytest.mark.parametrize(
    ("direction", "expected"), [("higher", [0, 2, 3]), ("lower", [0, 1])], ids=["higher", "lower"]
)
def test_the_front_has_the_points_that_no_other_dominates(direction, expected):
    times, values = pd.Series([1.0, 2.0, 3.0, 4.0, 4.0]), pd.Series([5.0, 4.0, 6.0, 9.0, 7.0])
    assert pareto.pareto_front(times, values, direction) == expected
