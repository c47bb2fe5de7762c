"""How far pixels move: the percentiles of numpy over the frames in which something moves."""

from dataclasses import replace

import numpy as np
import pytest

from rlbench.clips.motion import measure_motion
from tests.clips.clip_folders import HEADER, content, write_clip


@pytest.mark.parametrize("cuts", [(), (2,)])
def test_median_and_high_percentile_leave_out_first_frames_and_cuts(tmp_path, cuts):
    header = replace(HEADER, frames=4, reference_spp=(64,) * 4, cuts=cuts)
    folder = write_clip(tmp_path / "clip", header)
    lengths = [np.hypot(*content(i)["motion"].T) for i in range(1, 4) if i not in cuts]
    expected = np.percentile(np.concatenate(lengths), [50, 95])
    assert measure_motion([folder]) == pytest.approx(tuple(expected), rel=1e-5)  # stored in float32
