"""Unreliable times and times of two devices: drawn, marked, named, and never a front point."""

from __future__ import annotations

from dataclasses import replace

import matplotlib as mpl
import pytest

from reports import ablation, pareto, published_pareto, summary, table1
from reports.analysis.rows import device_mixes, unreliable_times
from reports.analysis.scores import Scores, metrics_with_values
from reports.pareto import OVERALL, PALE, UNRELIABLE, draw_pareto
from rlbench.benchmark.results import to_dataframe
from tests.reports.conftest import rows

BUSY = "unreliable: the machine was busy in 9 of 12 rounds"
MIX = "two devices: inference of a CPU, samples of a GPU"


def busy(method="ours", scene="hall", methods=("ours", "ours/latent-small", "oidn")):
    """Results in which the times of one method on one scene failed their test."""
    marked = []
    for row in rows(methods):
        is_time = row.metric in ("plan_ms", "denoise_ms")
        hit = is_time and (row.method, row.scene) == (method, scene)
        marked.append(replace(row, note=BUSY) if hit else row)
        if row.metric == "plan_ms":
            marked.append(replace(row, metric="inference_ms", note=BUSY if hit else ""))
    return to_dataframe(marked)


def of_two_devices(methods):
    frames = [
        replace(row, metric="frame_ms", note=MIX if row.method in methods else "")
        for row in rows(["ours", "oidn"])
        if row.metric == "plan_ms"
    ]
    return to_dataframe(rows(["ours", "oidn"]) + frames)


def test_a_mean_over_scenes_is_unreliable_if_one_scene_is():
    scores = Scores(busy())
    points = scores.points
    assert set(points.loc[points["unreliable"], "scene"]) == {"hall"}
    assert set(scores.overall.loc[scores.overall["unreliable"], "method"]) == {"ours"}


def test_an_unreliable_point_is_never_on_the_front():
    points = pareto.plotted_points(Scores(busy()))
    trusted = pareto.plotted_points(
        Scores(to_dataframe(rows(("ours", "ours/latent-small", "oidn"))))
    )
    for scene in ("hall", OVERALL):
        of_ours = (points["method"] == "ours") & (points["scene"] == scene)
        assert trusted.loc[of_ours, "front"].any()
        assert not points.loc[of_ours, "front"].any()
        assert points.loc[points["scene"] == scene, "front"].any()


def test_an_unreliable_point_is_pale():
    points = pareto.plotted_points(Scores(busy()))
    figure = draw_pareto(points, pareto.figure_labels(Scores(busy())))
    for axes in figure.axes:
        pale = [c for c in axes.collections if c.get_alpha() == PALE]
        count = sum(len(c.get_offsets()) for c in pale)
        assert count == (5 if axes.get_title(loc="left") in ("hall", OVERALL) else 0)
    labels = [text.get_text() for legend in figure.legends for text in legend.get_texts()]
    assert UNRELIABLE in labels


def test_a_figure_without_any_reliable_time_has_no_front(tmp_path):
    table = busy("ours", "hall", ["ours"])
    table = table[table["scene"] == "hall"]
    assert not pareto.plotted_points(Scores(table))["front"].any()
    assert pareto.write(table, tmp_path)


@pytest.mark.parametrize("report", [summary, table1, ablation])
def test_tables_mark_the_time_and_give_the_reason(report, tmp_path):
    page = next(
        f for f in report.write(busy(), tmp_path, draws=100) if f.suffix == ".md"
    ).read_text()
    assert "### Unreliable times" in page
    assert "inference_ms of ours on hall at 0.5, 1, 2, 4, 8 spp: the machine was busy" in page
    line = next(
        x
        for x in page.splitlines()
        if x.startswith(("| ours |", "| ours/latent-small |")) and "?" in x
    )
    assert "?" in line


def test_reliable_results_mark_nothing(results, tmp_path):
    page = summary.write(results, tmp_path, draws=100)[0].read_text()
    assert "Unreliable times" not in page
    assert "? |" not in page


def test_the_papers_figure_names_unreliable_times():
    caption = "".join(
        text.get_text()
        for text in published_pareto.draw_figures(Scores(busy("oidn")))["time"].texts
    )
    assert "Unreliable times, measured on a busy machine: oidn." in caption


def test_a_reason_is_one_line_for_all_rows_that_share_it():
    assert len(unreliable_times(busy())) == 1


def test_notes_of_times_are_no_remarks():
    assert Scores(busy()).remarks == []


@pytest.mark.parametrize(
    ("methods", "title"),
    [
        (("ours", "oidn"), "Two devices: inference of a CPU, samples of a GPU"),
        (("ours",), "Two devices: inference of a CPU, samples of a GPU (ours)"),
        ((), ""),
    ],
)
def test_the_title_says_which_frame_times_are_of_two_devices(methods, title):
    scores = Scores(of_two_devices(methods))
    assert set(device_mixes(scores.rows)) == ({MIX.partition(": ")[2]} if methods else set())
    assert pareto.figure_labels(scores).heading == title
    with mpl.rc_context():
        figure = draw_pareto(pareto.plotted_points(scores), pareto.figure_labels(scores))
    assert title in [text.get_text() for text in figure.texts]


def test_numbers_about_the_clock_are_no_scores():
    row = rows(["ours"])[0]
    clock = replace(row, frame=-1, metric="clock_rounds", value=4.0, unit="", direction="")
    assert metrics_with_values(to_dataframe([*rows(["ours"]), clock])) == ["psnr", "relmse"]
