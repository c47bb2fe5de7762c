"""Oracles know the truth of a frame, and can only win by it."""

from __future__ import annotations

import pytest
import torch

from baselines.accumulate.memory import History
from research.bounds import InformedBlend, measure_clip, summarize
from rlbench.ops.accumulation import AccumulatedRadiance
from tests.procedural_folder import write_world


def blend_weight(truth, denoised, last, side=1):
    zero = torch.zeros_like(truth[:, :1])
    radiance = AccumulatedRadiance(last, zero, zero)
    history = History(radiance, last, zero, torch.ones_like(zero), zero.bool())
    blend = InformedBlend(None, None, None, truths=iter([truth]), side=side)
    return blend.blend_weight(denoised, history)


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_a_blend_that_knows_the_truth_finds_the_share_it_was_mixed_by(share):
    denoised, last = torch.rand(2, 1, 3, 12, 12, generator=torch.Generator().manual_seed(0))
    weight = blend_weight(torch.lerp(denoised, last, share), denoised, last)
    assert torch.allclose(weight, torch.full_like(weight, share), atol=1e-5)


def test_the_share_of_a_window_is_the_least_squares_one_of_a_grid():
    truth, denoised, last = torch.rand(3, 1, 3, 9, 9, generator=torch.Generator().manual_seed(1))
    weight = blend_weight(truth, denoised, last, side=9)[0, 0, 4, 4]  # the window is the image
    grid = torch.linspace(0, 1, 1001)
    errors = [(torch.lerp(denoised, last, w) - truth).square().sum() for w in grid]
    assert weight == pytest.approx(float(grid[int(torch.stack(errors).argmin())]), abs=1e-3)


def test_bounds_of_a_clip_name_every_part_and_truth_in_single_pixels_wins(tmp_path):
    bounds = list(measure_clip(write_world(tmp_path / "world", frames=4), 1.0))
    gains = summarize(bounds)[1.0]
    assert gains["blend by the truth, 1x1"] > max(0.0, gains["blend by the truth, 31x31"])
    assert gains["2 times the samples"] > gains["1.25 times the samples"]
    assert {part.split(",")[0] for part in gains.index} >= {
        "uniform samples",
        "first frame by oidn",
    }
