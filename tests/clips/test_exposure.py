"""Exposure: areas of any size, and the rule of Reinhard et al. Motion: percentiles of numpy."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from rlbench.clips.exposure import area_luminance, exposure_from_areas
from rlbench.clips.motion import measure_motion
from tests.clips.clip_folders import HEADER, content, write_clip


def test_areas_are_means_of_tiles():
    image = np.random.default_rng(0).random((24, 40, 3))
    grey = image @ [0.2126, 0.7152, 0.0722]
    expected = [grey[y : y + 3, x : x + 5].mean() for y in range(0, 24, 3) for x in range(0, 40, 5)]
    np.testing.assert_allclose(area_luminance(image), expected, rtol=1e-6)  # weights in float32


@pytest.mark.parametrize("size", [(12, 16), (5, 9), (71, 97)])
def test_an_image_of_any_size_has_64_areas(size):
    areas = area_luminance(np.full((*size, 3), 2.0))
    np.testing.assert_allclose(areas, np.full(64, 2.0), rtol=1e-6)


def test_bright_areas_lower_the_exposure_to_white():
    areas = np.array([0.01] * 80 + [10.0] * 20)
    assert exposure_from_areas(areas) == pytest.approx(0.1)


@pytest.mark.parametrize("cuts", [(), (2,)])
def test_median_and_high_percentile_leave_out_first_frames_and_cuts(tmp_path, cuts):
    header = replace(HEADER, frames=4, reference_spp=(64,) * 4, cuts=cuts)
    folder = write_clip(tmp_path / "clip", header)
    lengths = [np.hypot(*content(i)["motion"].T) for i in range(1, 4) if i not in cuts]
    expected = np.percentile(np.concatenate(lengths), [50, 95])
    assert measure_motion([folder]) == pytest.approx(tuple(expected), rel=1e-5)  # stored in float32
