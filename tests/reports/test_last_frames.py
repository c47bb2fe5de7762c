"""The report on last frames, from scores whose means and ratios are known."""

from __future__ import annotations

import itertools
import math

import pytest

from reports import last_frames
from reports.analysis.scores import Scores, keep_last_frames
from rlbench.benchmark.results import Row, to_dataframe
from tests.reports.conftest import cells

SCENES = {"hall": 1.0, "city": 100.0}  # factor of relL2
# by method: relL2 at first, at last; theirs learns, the others are steady
ERRORS = {"cross": (0.801, 0.1), "oidn": (0.2, 0.2), "svgf": (0.4, 0.4), "bmfr": (0.4, 0.4)}
FRAMES = 8
KINDS = {"psnr": ("dB", "higher"), "rel_l2": ("", "lower")}


def table(metrics=tuple(KINDS), methods=tuple(ERRORS)):
    rows = []
    for metric, method, (scene, factor), frame in itertools.product(
        metrics, methods, SCENES.items(), range(FRAMES)
    ):
        error = ERRORS[method][frame >= FRAMES * 3 // 4]
        value = 20 - 10 * math.log10(error) if metric == "psnr" else factor * error
        rows.append(
            Row("r", method, scene, scene, 2.0, 2.0, frame, metric, value, *KINDS[metric],
                f"convention of {metric}", device="CPU", preset="mini")
        )  # fmt: skip
    return to_dataframe(rows)


def test_the_last_quarter_of_each_clip_is_shown_beside_all_frames(tmp_path):
    page = last_frames.write(table(), tmp_path)[0].read_text()
    means = [6 / 8 * 0.801 + 2 / 8 * 0.1, 0.1]
    for part, mean in zip((last_frames.ALL, last_frames.LAST), means, strict=True):
        found = float(cells(page, f"relL2, {part}, mean", "cross")[0].split(" ")[0])
        assert found == pytest.approx(mean * (1 + 100) / 2, rel=0.01)
    assert cells(page, f"PSNR, {last_frames.LAST}", "cross") == ["30.00"]
    assert cells(page, f"relL2, {last_frames.LAST}, by scene", "bmfr") == ["40", "0.4"]


def test_the_papers_order_has_a_verdict_by_the_ratio_of_each_scene(tmp_path):
    page = last_frames.write(table(), tmp_path)[0].read_text()
    assert cells(page, "Order of the paper", "cross / oidn") == [
        "0.46, 0.60", "3.13 [3.13, 3.13] contradicted", "0.50 [0.50, 0.50] reproduced",
    ]  # fmt: skip
    # the paper's scenes disagree on this pair
    assert cells(page, "Order of the paper", "svgf / bmfr")[1] == "1.00 [1.00, 1.00]"


@pytest.mark.parametrize(
    ("results", "absent"),
    [(table(metrics=("psnr",)), "relL2"), (table(methods=("oidn",)), "Order of the paper")],
)
def test_what_was_not_measured_is_left_out(results, absent, tmp_path):
    page = last_frames.write(results, tmp_path)[0].read_text()
    assert absent not in page
    assert last_frames.LAST in page


def test_a_clip_of_few_frames_keeps_its_last_one():
    rows = table()
    kept = keep_last_frames(rows[(rows["frame"] < 3) | (rows["clip"] == "hall")])
    assert set(kept.loc[kept["clip"] == "hall", "frame"]) == {6, 7}
    assert set(kept.loc[kept["clip"] == "city", "frame"]) == {2}
    assert Scores(kept).measured["method"].nunique() == len(ERRORS)
