"""Drift: how the PSNR of a clip changes from its first to its last quarter."""

import math

import pytest
import torch

from metrics.catalog import PSNR
from metrics.catalog_video import DRIFT, drift


@pytest.mark.parametrize(
    ("scores", "expected"),
    [
        ([20.0] * 24, 0.0),
        ([20.0] * 6 + [30.0] * 12 + [19.0, 19.0, 19.0, 17.0, 17.0, 17.0], -2.0),
        ([20.0, 25.0], 5.0),  # a quarter has at least one frame
        ([math.nan, 25.0, 25.0, 25.0], math.nan),
    ],
)
def test_the_last_quarter_less_the_first(scores, expected):
    assert drift(scores) == pytest.approx(expected, nan_ok=True)


def test_frames_and_their_psnr_give_the_same_drift():
    g = torch.Generator().manual_seed(0)
    right = torch.rand(1, 3, 16, 16, generator=g)
    noise = [0.1 + 0.02 * frame for frame in range(8)]
    frames = [
        DRIFT.compare(right + each * torch.randn(right.shape, generator=g), right, right)
        for each in noise
    ]
    by_frame = [float(PSNR.score(frame)[0]) for frame in frames]
    assert float(DRIFT.score(frames)) == pytest.approx(drift(by_frame))
    assert drift(by_frame) < 0
