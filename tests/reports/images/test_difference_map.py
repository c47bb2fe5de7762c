"""Signed differences of squared error: their sign, their scale, and their distribution."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from reports import difference_map
from reports.difference_map import draw_differences, find_difference, large_difference

PAIR = ("eaw", "mean")


@pytest.fixture(scope="module")
def parts(kept):
    return [find_difference(clip, PAIR) for clip in kept.clips]


def test_a_row_with_less_error_has_negative_differences(kept, parts):
    for part in parts:
        mse = [10 ** (-kept.psnr(method, part.clip, 0) / 10) for method in PAIR]
        assert part.values[0].mean() == pytest.approx(mse[0] - mse[1], rel=0.01)
        assert part.values.mean() < 0  # a filter of one sample has less error than the sample


def test_swapped_rows_have_the_opposite_difference(kept, parts):
    swapped = find_difference(kept.clips[0], PAIR[::-1])
    assert np.array_equal(swapped.values, -parts[0].values)


def test_the_shown_frame_is_the_median_one(parts):
    means = parts[0].values.mean(axis=(1, 2))
    assert sorted(means).index(means[parts[0].typical_frame]) == len(means) // 2


def test_one_pixel_in_twenty_is_large(parts):
    values = np.concatenate([part.values.ravel() for part in parts])
    assert (abs(values) > large_difference(parts)).mean() == pytest.approx(0.05, abs=0.001)


def test_all_maps_share_one_scale_that_is_symmetric_about_zero(parts):
    figure = draw_differences(parts, "2 clips")
    signed = [axes.images[0] for axes in figure.axes if axes.get_title() == "eaw minus mean"]
    limits = {image.get_clim() for image in signed}
    assert len(signed) == 2
    assert len(limits) == 1
    low, high = limits.pop()
    assert low == -high


def test_the_histogram_holds_every_pixel(parts):
    figure = draw_differences(parts[:1], "1 clip")
    bars = next(axes for axes in figure.axes if axes.patches and axes.get_yscale() == "log")
    assert sum(bar.get_height() for bar in bars.patches) == pytest.approx(1)


def test_the_table_has_the_shares_of_better_and_worse_pixels(kept, parts, tmp_path):
    files = difference_map.write(kept.rows, tmp_path, kept.clips, PAIR)
    row = pd.read_csv(files[-1]).iloc[0]
    assert row["better"] == pytest.approx((parts[0].values < 0).mean())
    assert row["better"] + row["worse"] <= 1
