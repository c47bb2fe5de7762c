"""The figure of the parts of a frame: the bars are the numbers, and they add up."""

from __future__ import annotations

from dataclasses import replace

import pandas as pd
import pytest
from matplotlib.image import imread

from reports import frame_time
from reports.analysis.scores import FRAME_PARTS, Scores
from reports.frame_time import MAX_PANELS, PARTS, draw_frame_bars
from rlbench.benchmark.results import MissingRowsError, to_dataframe
from tests.reports.conftest import SAMPLE_MS, rows


def widths(axes, method):
    """Widths of the parts of one method's bar, from left to right."""
    labels = [text.get_text() for text in axes.get_yticklabels()]
    bars = [
        b for b in axes.patches if round(b.get_y() + b.get_height() / 2) == labels.index(method)
    ]
    return [bar.get_width() for bar in bars]


def with_parts():
    """The made-up results, with a G-buffer of 3 ms and 2 ms of allocation for `ours`."""
    table = rows()
    plan = [r for r in table if r.metric == "plan_ms"]
    extra = [replace(r, metric="gbuffer_ms", value=3.0) for r in plan]
    extra += [replace(r, metric="allocate_ms", value=2.0 * (r.method == "ours")) for r in plan]
    return to_dataframe(table + extra)


@pytest.fixture(scope="module")
def times():
    return frame_time.frame_times(Scores(with_parts()))


def test_the_parts_of_every_bar_add_up_to_its_frame_time(times):
    assert times[FRAME_PARTS].sum(axis=1).tolist() == pytest.approx(times["frame_ms"].tolist())


def test_the_bars_are_the_parts_in_the_order_of_a_frame(times):
    figure = draw_frame_bars(times[times["target_spp"] == 2.0], "caption")
    (axes,) = figure.axes
    sampling = 1.98 * sum(SAMPLE_MS.values()) / 4
    assert widths(axes, "ours") == pytest.approx([3.0, 5.5, 2.0, sampling, 11.0])
    assert widths(axes, "oidn") == pytest.approx([3.0, 0.0, 0.0, sampling, 9.0])
    assert list(PARTS) == FRAME_PARTS


def test_results_without_a_g_buffer_and_allocation_are_charged_none(results):
    times = frame_time.frame_times(Scores(results))
    assert set(times["gbuffer_ms"]) == set(times["allocate_ms"]) == {0.0}


def test_every_file_is_written_and_the_csv_has_all_budgets(results, tmp_path):
    files = frame_time.write(results, tmp_path)
    assert [f.name for f in files] == [f"frame-time.{x}" for x in ("png", "pdf", "svg", "csv")]
    assert 0.02 < (imread(files[0])[..., :3].min(2) < 0.9).mean() < 0.7
    assert pd.read_csv(files[-1])["target_spp"].nunique() == 5 > MAX_PANELS


def test_unreliable_times_are_marked(results):
    busy = [
        replace(r, note="unreliable: busy")
        if (r.method, r.scene, r.metric) == ("ours", "hall", "plan_ms")
        else r
        for r in rows()
    ]
    times = frame_time.frame_times(Scores(to_dataframe(busy)))
    assert set(times.loc[times["unreliable"], "method"]) == {"ours"}
    figure = draw_frame_bars(times[times["target_spp"] == 1.0], "caption")
    texts = [text.get_text() for text in figure.axes[0].texts]
    assert sum(text.endswith("?") for text in texts) == 1


def test_results_without_times_have_no_figure(tmp_path):
    timeless = to_dataframe([r for r in rows() if r.unit != "ms"])
    with pytest.raises(MissingRowsError, match="no method has a frame time"):
        frame_time.write(timeless, tmp_path)


def test_a_method_that_lacks_a_budget_is_named_in_its_panel(times):
    part = times[(times["method"] != "ours") | (times["target_spp"] > 1)]
    figure = draw_frame_bars(part[part["target_spp"].isin([1.0, 2.0])], "caption")
    assert [t.get_text() for t in figure.axes[0].texts].count("not measured") == 1
