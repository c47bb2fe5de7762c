"""Frames to recover after an event, from curves whose recovery is known."""

from __future__ import annotations

from functools import partial
from itertools import combinations, product

import matplotlib as mpl
import pytest

from reports import recovery
from reports.analysis.scores import Scores
from reports.layout import style
from reports.recovery import (
    draw_event_panels,
    find_events,
    find_spans,
    measure_recoveries,
    measure_span,
)
from rlbench.benchmark.results import EVENT_PREFIX, Row, to_dataframe

FRAMES, CUT, LIGHT = 20, 10, 15
LEVEL = {"memory": 30.0, "steady": 25.0}


def psnr(method, frame):
    """`memory` falls by 8 dB at each event and halves its loss in each frame; `steady` does not."""
    if method == "steady":
        return LEVEL[method]
    since = frame - max(start for start in (0, CUT, LIGHT) if start <= frame)
    return LEVEL[method] - 8.0 * 0.5**since


def table(events=((CUT, "cut"), (LIGHT, "light")), clips=("hall-cut", "city-cut"), spp=(1.0, 4.0)):
    rows = []
    for method, clip, budget in product(LEVEL, clips, spp):
        scene = clip.partition("-")[0]
        row = partial(Row, "r1", method, clip, scene, budget, budget, convention="peak 1")
        rows += [row(frame, "psnr", psnr(method, frame), "dB", "higher") for frame in range(FRAMES)]
        rows += [row(frame, f"{EVENT_PREFIX}{name}", 1.0) for frame, name in events]
    return to_dataframe(rows)


def test_events_come_from_the_rows_once_a_clip_and_spans_end_at_the_next():
    spans = find_spans(Scores(table()))
    assert spans["frame"].tolist() == [CUT, LIGHT] * 2
    assert spans["event"].tolist() == ["cut", "light"] * 2
    assert spans["length"].tolist() == [LIGHT - CUT, FRAMES - LIGHT] * 2
    both = find_events(table(events=((4, "cut"), (4, "light"))))
    assert both[["frame", "event"]].to_numpy().tolist() == [[4, "cut and light"]] * 2


@pytest.mark.parametrize(
    ("psnr", "frames", "loss", "is_bound"),
    [
        ([25.0] * 8, 0, 0.0, False),
        ([20.0, 24.4, 24.6, 25.0, 25.0, 25.0, 25.0, 25.0], 2, 5.0, False),
        ([24.51, 25.0, 25.0, 25.0], 0, 0.49, False),
        ([20.0, 21.0, 22.0, 23.0, 24.0, 25.0], 4, 4.5, True),  # still rising
        ([20.0, 20.0, 25.0, 25.0], 2, 5.0, True),  # reached where the level is taken
        ([27.0, 25.0, 25.0, 25.0], 0, -2.0, False),
    ],
)
def test_a_span_has_recovered_in_the_first_frame_within_half_a_decibel(
    psnr, frames, loss, is_bound
):
    found = measure_span(psnr)
    assert (found.frames, found.is_bound) == (frames, is_bound)
    assert found.loss == pytest.approx(loss)
    assert found.level == pytest.approx(psnr[0] + loss)  # the mean of the last quarter


def test_a_method_without_memory_recovers_at_once_and_one_with_memory_later():
    found = measure_recoveries(Scores(table())).set_index(["method", "event"])
    assert set(found.loc["steady", "frames"]) == {0}
    # spans of 5: losses 8, 4, 2, 1, 0.5 dB; the level is 0.75 dB short, so 1 dB is within 0.5 of it
    assert set(found.loc["memory", "frames"]) == {3}
    assert found.loc["memory", "loss"].tolist() == pytest.approx([7.25] * 8)
    assert found.loc["memory", "is_bound"].all()
    assert len(found) == 2 * 2 * 2 * 2  # methods, clips, budgets, events


def test_the_page_names_events_that_are_left_out(tmp_path):
    rows = table(events=((7, "light"), (CUT, "cut")), clips=("hall-cut",))
    page = recovery.write(rows, tmp_path)[0].read_text()
    assert "### Frames to recover, a cut" in page
    assert "| steady | 0.0 | 0.0 |" in page  # one clip has no interval
    assert "hall-cut: light at frame 7, as the next event or the end is 3 frames later" in page


def test_means_have_an_interval_over_scenes_and_say_where_they_are_a_bound():
    summary = recovery.summarize(measure_recoveries(Scores(table())))
    memory = summary.set_index(["method", "column"]).loc[("memory", "frames")]
    assert memory[["mean", "low", "high"]].drop_duplicates().to_numpy().tolist() == [[3, 3, 3]]
    assert (memory["bounds"] == memory["events"]).all()


def test_every_panel_has_the_curves_of_its_clip_and_marks_its_events():
    rows = table()
    curves = Scores(rows).per_frame.query("target_spp == 1.0")
    figure = draw_event_panels(curves, find_spans(Scores(rows)), "caption")
    assert [axes.get_title(loc="left") for axes in figure.axes] == ["city-cut", "hall-cut"]
    for axes in figure.axes:
        memory, steady, *marks = axes.lines[:4]
        assert memory.get_ydata().tolist() == [psnr("memory", f) for f in range(FRAMES)]
        assert steady.get_ydata().tolist() == [LEVEL["steady"]] * FRAMES
        assert [line.get_xdata()[0] for line in marks] == [CUT - 0.5, LIGHT - 0.5]


@pytest.mark.parametrize("name", ["mean", "accumulate/denoised-variance@openvino-half"])
def test_no_label_at_the_end_of_a_curve_is_cut_or_meets_the_next_panel(name):
    clips = ("hall-cut", "city-cut", "ripples-cut", "temple-cut")
    rows = table(clips=clips, spp=(1.0,)).replace({"method": {"memory": name}})
    scores = Scores(rows)
    with mpl.rc_context(style.RC):
        figure = draw_event_panels(scores.per_frame, find_spans(scores), "caption")
        figure.draw_without_rendering()
        boxes = [axes.get_tightbbox() for axes in figure.axes]
    names = [text.get_text() for axes in figure.axes for text in axes.texts]
    assert sum(text.startswith(name) for text in names) == 4
    assert all(box.x0 >= 0 and box.x1 <= figure.bbox.x1 for box in boxes)
    assert not any(a.overlaps(b) for a, b in combinations(boxes, 2))
