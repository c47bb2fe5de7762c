"""Expected scores where some frames are late."""

from __future__ import annotations

import pandas as pd
import pytest

from reports.analysis.scores import has_late_scores, with_misses


def table(*rows):
    names = ["metric", "frame", "value"]
    cell = {"method": "m", "clip": "c", "target_spp": 1.0, "seed": 0, "device": "d"}
    return pd.DataFrame(rows, columns=names).assign(**cell)


def test_a_late_frame_counts_with_the_psnr_of_the_image_before():
    rows = table(("psnr", 0, 30.0), ("psnr", 1, 30.0), ("psnr_late", 1, 20.0))
    expected = with_misses(rows, share=0.1)
    assert expected["value"].tolist() == pytest.approx([30.0, 29.0, 20.0])


def test_every_frame_late_is_the_psnr_of_the_images_before():
    rows = table(("psnr", 1, 30.0), ("psnr_late", 1, 20.0), ("ssim", 1, 0.5))
    assert with_misses(rows, share=1.0)["value"].tolist() == [20.0, 20.0, 0.5]


def test_scores_of_another_method_or_budget_are_not_mixed_in():
    rows = pd.concat(
        [
            table(("psnr", 1, 30.0)),
            table(("psnr_late", 1, 20.0)).assign(method="other"),
            table(("psnr_late", 1, 20.0)).assign(target_spp=2.0),
        ],
        ignore_index=True,
    )
    assert with_misses(rows)["value"].iloc[0] == 30.0


def test_results_without_late_frames_stay_as_they_are():
    rows = table(("psnr", 0, 30.0), ("psnr", 1, float("nan")))
    assert not has_late_scores(rows)
    pd.testing.assert_frame_equal(with_misses(rows), rows)
