"""The Pareto plot: what is drawn is what was measured, and every file is there."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace

import pandas as pd
import pytest
from conftest import METHODS, SAMPLE_MS, SCENES, rows
from matplotlib.image import imread

from reports import pareto
from reports.analysis.aggregate import ReportError
from reports.layout import style
from reports.layout.pareto_panels import MOST, OVERALL, WINDOW, draw
from rlbench.benchmark.results import to_dataframe

TEXTS = {"value": "PSNR", "direction": "", "better": "higher", "caption": "profile paper-2080ti"}


@pytest.fixture(scope="module")
def figure(results):
    return draw(pareto.curves(results), TEXTS)


@pytest.fixture(scope="module")
def files(results, tmp_path_factory):
    return pareto.write(results, tmp_path_factory.mktemp("pareto"))


def drawn(figure, panel, method):
    """Times and values of a curve as matplotlib holds them."""
    axes = next(a for a in figure.axes if a.get_title(loc="left") == panel)
    color = style.line_styles(METHODS)[method].color
    line = next(a for a in axes.lines if a.get_color() == color and a.get_linestyle() == "-")
    return line.get_xdata(), line.get_ydata()


def test_four_files_are_written(files):
    assert [file.name for file in files] == [
        "pareto.png", "pareto.pdf", "pareto.svg", "pareto.csv",
    ]  # fmt: skip
    assert all(file.stat().st_size > 1000 for file in files)


def test_the_png_is_a_picture_with_ink(files):
    picture = imread(files[0])
    assert picture.shape[1] == 1950  # 13 inches at 150 dpi
    assert 0.02 < (picture[..., :3].min(2) < 0.9).mean() < 0.5


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


def test_the_csv_holds_what_is_plotted(results, files):
    found = pd.read_csv(files[-1])
    pd.testing.assert_frame_equal(found, pareto.curves(results))


def test_there_is_a_panel_for_each_scene(figure):
    assert [a.get_title(loc="left") for a in figure.axes] == [OVERALL, *sorted(SCENES)]


def test_a_mean_of_some_scenes_is_not_drawn_as_that_of_all_and_is_told(tmp_path):
    made = rows(["ours", "oidn"])
    table = to_dataframe(
        [r for r in made if (r.method, r.scene, r.metric) != ("oidn", "hall", "sample_ms")]
    )
    found = pareto.curves(table)
    assert set(found[found["scene"] == OVERALL]["method"]) == {"ours"}
    assert set(found[found["scene"] == "city"]["method"]) == {"ours", "oidn"}
    files = pareto.write(table, tmp_path)
    assert "Without a time on every scene: oidn" in pareto._texts(table, "psnr", "x")["caption"]
    assert all(file.exists() for file in files)


def test_a_frame_that_is_missing_is_told():
    table = to_dataframe(
        [r for r in rows() if (r.method, r.clip, r.frame) != ("ours", "city-0", 2)]
    )
    caption = pareto._texts(table, "psnr", "x")["caption"]
    assert "Not on every scene and frame: ours." in caption


def test_many_scenes_are_one_panel_of_their_mean():
    every = pareto.curves(to_dataframe(rows()))
    parts = [every.assign(scene=f"generated-{number}") for number in range(MOST + 1)]
    axes = draw(pd.concat([every[every["scene"] == OVERALL], *parts]), TEXTS).axes
    assert [a.get_title(loc="left") for a in axes] == [OVERALL]


def test_times_of_what_is_not_shown_stretch_no_axis(results):
    every = pareto.curves(results)
    far = every.iloc[[0]].assign(method="mean", value=every["value"].max() - 50, frame_ms=1e6)
    for axes in draw(pd.concat([every, far.assign(scene=OVERALL, front=False)]), TEXTS).axes[:1]:
        assert axes.get_xlim()[1] < 1e4


def test_one_scene_is_one_panel():
    one = to_dataframe([r for r in rows() if r.scene == "city"])
    assert [a.get_title(loc="left") for a in draw(pareto.curves(one), TEXTS).axes] == ["city"]


def test_times_that_span_more_than_ten_are_logarithmic(figure):
    assert {a.get_xscale() for a in figure.axes} == {"log"}


def test_times_that_span_less_than_ten_are_linear():
    near = to_dataframe([r for r in rows(["ours", "ntas"]) if r.target_spp in (1, 2)])
    assert {a.get_xscale() for a in draw(pareto.curves(near), TEXTS).axes} == {"linear"}


def test_what_lies_below_the_window_is_named(figure):
    axes = figure.axes[0]
    top = 29.9 + 3 * 1.15 + sum(SCENES.values()) / 4
    assert axes.get_ylim()[0] == pytest.approx(top - WINDOW * 1.07)
    assert [text.get_text() for text in axes.texts] == ["below: mean from 13.0"]


def test_no_two_titles_of_a_panel_touch(figure):
    figure.draw_without_rendering()
    for axes in figure.axes:
        assert not axes._left_title.get_window_extent().overlaps(
            axes._right_title.get_window_extent()
        )


def test_the_front_is_on_the_method_that_is_best_for_its_time(results):
    found = pareto.curves(results)
    front = found[found["front"] & (found["scene"] == OVERALL)].sort_values("frame_ms")
    assert front["method"].tolist()[:2] == ["mean", "ours/small"]
    assert (front["value"].diff().dropna() > 0).all()
    assert front["method"].iloc[-1] == "ours"


def test_the_caption_names_device_and_cost_profile(results, tmp_path, monkeypatch):
    monkeypatch.setitem(style.RC, "svg.fonttype", "none")  # letters, not their outlines
    svg = pareto.write(results, tmp_path)[2].read_text()
    for text in ("profile paper-2080ti", "NVIDIA RTX 2080 Ti", "up is better"):
        assert text in svg


def test_methods_without_a_scene_in_common_have_no_panel_of_their_mean(tmp_path):
    table = to_dataframe([r for r in rows(["ours"]) if r.scene == "city"])
    other = to_dataframe([r for r in rows(["ntas"]) if r.scene == "hall"])
    pareto.write(pd.concat([table, other]), tmp_path)
    assert set(pd.read_csv(tmp_path / "pareto.csv")["scene"]) == {"city", "hall"}
    assert (tmp_path / "pareto.png").is_file()


def test_many_scenes_without_a_common_method_are_refused(tmp_path):
    parts = [
        replace(row, method=f"mine-{place}", scene=f"{row.scene}{place}", clip=f"c{place}")
        for place in range(3)
        for row in rows(["ours"])
    ]
    with pytest.raises(ReportError, match="12 scenes.*fewer scenes"):
        pareto.write(to_dataframe(parts), tmp_path)


def test_each_device_has_a_plot_of_its_own(tmp_path):
    mixed = to_dataframe(rows(["ours"]) + rows(["ntas"], device="H100"))
    files = {file.name for file in pareto.write(mixed, tmp_path) if file.suffix == ".csv"}
    assert files == {"pareto-h100.csv", "pareto-nvidia-rtx-2080-ti.csv"}
    assert set(pd.read_csv(tmp_path / "pareto-h100.csv")["method"]) == {"ntas"}


def test_without_times_it_says_what_is_missing(tmp_path):
    timeless = to_dataframe([r for r in rows(["ours"]) if r.unit != "ms"])
    with pytest.raises(ReportError, match="no cell has psnr, plan_ms, denoise_ms and sample_ms"):
        pareto.write(timeless, tmp_path)


def test_equal_results_give_equal_files(results, files, tmp_path):
    again = pareto.write(results, tmp_path)
    assert [f.read_bytes() for f in files] == [f.read_bytes() for f in again]


@pytest.mark.parametrize(("better", "edge"), [("higher", 0), ("lower", 1)])
def test_what_a_single_point_beats_is_grey_on_its_worse_side(better, edge):
    point = to_dataframe([r for r in rows(["ours"]) if r.scene == "city" and r.target_spp == 1])
    axes = draw(pareto.curves(point), TEXTS | {"better": better}).axes[0]
    heights = axes.collections[0].get_paths()[0].vertices[:, 1]
    assert {round(h, 6) for h in heights} == {29.9, round(axes.get_ylim()[edge], 6)}


def test_an_error_is_better_below(results):
    found = pareto.curves(results, "relmse")
    front = found[found["front"] & (found["scene"] == "city")].sort_values("frame_ms")
    assert (front["value"].diff().dropna() < 0).all()


def test_reports_do_not_import_torch():
    look = "import sys, reports.pareto, reports.summary; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", look], check=False).returncode == 0
