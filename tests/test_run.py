"""Gradients: kept by `unroll`, off in `run_clip`."""

from __future__ import annotations

from dataclasses import dataclass

import pytest
import torch

from rlbench.clips.procedural.clip import procedural_clip
from rlbench.frames import Size
from rlbench.run import run_clip, unroll
from tests.test_page import CallRecorder

SIZE = Size(1, 9, 11)


@pytest.mark.parametrize(("run", "has_gradient"), [(unroll, True), (run_clip, False)])
def test_only_unroll_keeps_gradients(run, has_gradient):
    weight = torch.ones((), requires_grad=True)

    @dataclass(frozen=True)
    class Scaled(CallRecorder):
        def denoise(self, gbuffer, samples, state):
            return samples.mean * weight, state

    result = next(iter(run(Scaled(), procedural_clip(size=SIZE, frames=1), 1.0)))
    assert result.image.requires_grad is has_gradient


def test_interleaved_runs_do_not_change_the_gradient_mode():
    clips = [procedural_clip(seed, SIZE, frames=2) for seed in (0, 1)]
    for _ in zip(*(run_clip(CallRecorder(), clip, 1.0) for clip in clips), strict=True):
        assert not torch.is_inference_mode_enabled()
    assert not torch.is_inference_mode_enabled()
