"""Slices over time show the row of the images in which flicker differs most."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from reports import error_places, time_slices
from reports.time_slices import find_slice, flicker

PAIR = ("eaw", "mean")


def test_a_slice_is_one_row_of_all_frames(kept):
    clip = kept.clips[0]
    part = find_slice(clip, PAIR)
    image = next(each for each in clip.images if each.method == "mean")
    assert np.array_equal(part.images["mean"], image.frames[:, :, part.row].swapaxes(0, 1))
    assert np.array_equal(part.reference, clip.reference[:, :, part.row].swapaxes(0, 1))


def test_no_row_has_a_larger_difference_of_flicker(kept):
    clip = kept.clips[0]
    images = {each.method: each.frames for each in clip.images}
    levels = [flicker(images[name], clip.reference).mean(axis=(0, 2)) for name in PAIR]
    assert find_slice(clip, PAIR).row == int(abs(levels[0] - levels[1]).argmax())


def test_an_error_that_stays_is_no_flicker(kept):
    reference = kept.clips[0].reference * 0.5
    assert flicker(reference, reference).max() == 0
    steady = np.repeat(reference[:1], 3, axis=0)
    assert flicker(steady + 0.1, steady).max() == pytest.approx(0, abs=1e-12)


def test_both_reports_write_a_figure_and_a_table(kept, tmp_path):
    for report, name in ((time_slices, "slices"), (error_places, "where")):
        files = report.write(kept.rows, tmp_path, kept.clips, PAIR)
        assert [f.name for f in files] == [f"{name}.{s}" for s in ("png", "pdf", "svg", "csv")]
        assert set(pd.read_csv(files[-1])["method"]) == set(PAIR)
